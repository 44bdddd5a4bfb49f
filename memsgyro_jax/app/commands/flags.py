"""Kinds of options that several commands share."""

from typing import Annotated

import cyclopts


Flag = Annotated[bool, cyclopts.Parameter(negative=())]
Words = Annotated[tuple[str, ...], cyclopts.Parameter(consume_multiple=True)]
Numbers = Annotated[tuple[float, ...], cyclopts.Parameter(consume_multiple=True)]
