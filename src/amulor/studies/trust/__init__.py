"""Trust study: reliability of the rejection methods in scenes with known ranges.

A pixel is trusted if its flags are zero in the target signal and in the range image.
The study counts what trusted pixels are worth: how many there are, how often their
intervals hold the surface, and how far off the worst of them is.
"""
