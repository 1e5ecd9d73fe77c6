"""Reports as text, Markdown and plots."""
