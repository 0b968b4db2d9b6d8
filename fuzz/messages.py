"""Whatever bytes the bus carries: a message of its topic or MessageError; what is read is sound.

The first byte chooses the topic or the request.
"""

from common.codec import decode, decode_record, encode, encode_record
from common.errors import MessageError
from common.messages import Message, Record, Reply
from common.topics import REQUESTS, TOPICS

MAX_BYTES = 4200  # a little more than a message may have
MESSAGES: tuple[type[Message], ...] = tuple(topic.message for topic in TOPICS)
RECORDS: tuple[type[Record], ...] = (*(request.message for request in REQUESTS), Reply)


def check(data: bytes) -> None:
    """Decode; what decodes can be encoded and decodes into the same."""
    if not data:
        return
    choice, body = data[0] % (len(MESSAGES) + len(RECORDS)), data[1:]
    try:
        if choice < len(MESSAGES):
            _check_message(body, MESSAGES[choice])
        else:
            _check_record(body, RECORDS[choice - len(MESSAGES)])
    except MessageError as error:
        assert str(error)


def _check_message(body: bytes, kind: type[Message]) -> None:
    header, message = decode(body, kind)
    again = encode(header, message)
    assert decode(again, kind) == (header, message)


def _check_record(body: bytes, kind: type[Record]) -> None:
    record = decode_record(body, kind)
    assert decode_record(encode_record(record), kind) == record
