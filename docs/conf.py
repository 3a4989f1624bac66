"""Settings of the documentation site; ``make docs`` builds it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "pipelines" / "wheel" / "src"))

project = "isoparticles"
project_copyright = "the isoparticles developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
# results/ contains the template of results.md; notebooks are meant for Jupyter, the paper for JOSS
exclude_patterns = ["results", "notebooks", "paper"]
html_theme = "furo"
html_title = "isoparticles"
html_show_sphinx = False
myst_enable_extensions = ["dollarmath"]
# links to headings, as in [a](page.md#heading)
myst_heading_anchors = 4
nitpicky = True

# python.md comes from the sources of the package; neither the native module nor its dependencies
# are needed to read them
autodoc_mock_imports = ["isoparticles._native", "numpy", "pyvista"]
autodoc_default_options = {
    "members": True,
    "inherited-members": "dict, Exception, Warning, object",
    "member-order": "bysource",
    "exclude-members": "__init__, __new__",
}
numpydoc_show_class_members = False
autodoc_class_signature = "separated"
python_maximum_signature_line_length = 80
add_module_names = False
nitpick_ignore_regex = [("py:.*", r"(numpy|pyvista|os)\..*|collections\.abc\..*|ArrayLike|NDArray|Image|Progress")]
