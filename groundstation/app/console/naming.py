"""Names of elements of the page."""


def named(name: str) -> str:
    """What makes an element findable for whoever looks at the page by a program."""
    return f'data-testid="{name}"'
