"""The page's server: who may ask, what is answered, and how it is served."""
