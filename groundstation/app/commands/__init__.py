"""One module per command of ``gs``; ``groundstation.app.cli`` puts them together."""
