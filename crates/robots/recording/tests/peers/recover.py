"""Counts the messages of an MCAP file that breaks off: from the front, until it does, as `mcap recover` reads."""

import sys

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader

count = 0
with open(sys.argv[1], "rb") as file:
    try:
        for record in StreamReader(file).records:
            count += isinstance(record, Message)
    except (EndOfFile, McapError):
        pass
print(count)
