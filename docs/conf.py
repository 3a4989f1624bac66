"""Settings of the documentation site; ``make docs`` builds it."""

project = "isoparticles"
project_copyright = "the isoparticles developers"
extensions = ["myst_parser"]
# results/ contains the template of results.md; notebooks are meant for Jupyter
exclude_patterns = ["results", "notebooks"]
html_theme = "furo"
html_title = "isoparticles"
html_show_sphinx = False
myst_enable_extensions = ["dollarmath"]
# links to headings, as in [a](page.md#heading)
myst_heading_anchors = 4
nitpicky = True
