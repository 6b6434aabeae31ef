"""Pages and figures of what was measured, which need matplotlib and jinja2."""
