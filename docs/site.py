"""What `mkdocs` needs to know of this checkout: pages link to source files, which a site does not have."""

import re
from typing import Any

PAGES = r"(?:reference/|decisions/|(?!README|CHANGELOG|CONTRIBUTING)[\w-]+\.md)"
OUTSIDE = re.compile(rf"\[([^\]]+)\]\((?:\.\./)+(?!{PAGES})[^)]*\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A link to a file outside docs/ becomes its name."""
    return OUTSIDE.sub(r"`\1`", markdown)
