"""Figures of Ricci et al. 2010, by number."""

from amulor.studies.ricci2010.figures import (
    depths,
    interference,
    lines,
    low_pass,
    scans,
)
from amulor.studies.ricci2010.results import PaperFigure

figure_01 = PaperFigure(1, depths.checks, depths.draw)
figure_03 = PaperFigure(3, low_pass.lower_checks, low_pass.draw_lower)
figure_04 = PaperFigure(4, low_pass.higher_checks, low_pass.draw_higher)
figure_05 = PaperFigure(5, scans.clear_checks, scans.draw_clear)
figure_06 = PaperFigure(6, scans.turbid_checks, scans.draw_turbid)
figure_07 = PaperFigure(7, interference.amplitude_checks, interference.draw_amplitude)
figure_08 = PaperFigure(8, interference.ratio_checks, interference.draw_ratio)
figure_09 = PaperFigure(9, interference.contrast_checks, interference.draw_contrast)
figure_10 = PaperFigure(10, lines.linear_checks, lines.draw_linear)
figure_11 = PaperFigure(11, lines.circular_checks, lines.draw_circular)
figure_12 = PaperFigure(12, lines.crossed_checks, lines.draw_crossed)
figure_13 = PaperFigure(13, scans.profile_checks, scans.draw_profiles)
figure_14 = PaperFigure(14, scans.surface_checks, scans.draw_surfaces_of_ladder)
figure_15 = PaperFigure(15, scans.disc_checks, scans.draw_disc)

#: All of them, in the order of the paper.
FIGURES = {
    figure.number: figure
    for figure in (
        figure_01,
        figure_03,
        figure_04,
        figure_05,
        figure_06,
        figure_07,
        figure_08,
        figure_09,
        figure_10,
        figure_11,
        figure_12,
        figure_13,
        figure_14,
        figure_15,
    )
}
