"""Parts of documents that programs write."""


def with_part(text: str, marker: str, part: str) -> str:
    """`text` with `part` between the lines `<!-- marker:start -->` and `<!-- marker:end -->`.

    Raises:
        ValueError: It lacks them.
    """
    start, end = f"<!-- {marker}:start -->", f"<!-- {marker}:end -->"
    head, found, rest = text.partition(start)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"there is no {start} with {end} after it")
    return f"{head}{start}\n{part}\n{end}{tail}"
