"""Parts of the site that Sphinx does not bring: `llms`, `mathematics`, `notebooks`, `pages`."""
