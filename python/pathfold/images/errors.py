"""What goes wrong with picture files, and OpenImageIO's own words for it."""


class ImageError(RuntimeError):
    """A file that cannot be read; the message names it and says why."""


class OutputError(RuntimeError):
    """A file that cannot be written; nothing of it is left behind."""


def first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text.strip() else ""
