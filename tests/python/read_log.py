"""Reads every message of logs with the Python packages `mcap`, `mcap-protobuf-support` and `mcap-ros2-support`.

usage: read_log.py LOG.mcap [LOG.mcap ...] [LAYOUT ...]

Prints each topic with its type and number of messages. Fails if a message cannot be decoded, if a number of a row is NaN,
or if a topic or field that a layout of Foxglove (.json) or PlotJuggler (.xml) names is in none of the logs.
"""

import json
import math
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter

from google.protobuf.message import Message
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2


def flat(value, prefix, out):
    """Adds each number and text of a message to `out`: path and value."""
    if isinstance(value, Message):
        for field, inner in value.ListFields():
            flat(inner, f"{prefix}.{field.name}", out)
    elif hasattr(value, "__slots__"):
        for name in value.__slots__:
            flat(getattr(value, name), f"{prefix}.{name}", out)
    elif hasattr(value, "__len__") and not isinstance(value, (str, bytes)):
        for index, inner in enumerate(value):
            flat(inner, f"{prefix}[{index}]", out)
    else:
        out[prefix] = value


def foxglove_paths(node):
    """Topics and paths that a Foxglove layout names."""
    if isinstance(node, dict):
        for key, inner in node.items():
            if key == "topics" and isinstance(inner, dict):
                yield from inner
            elif key in ("value", "topicPath", "path") and isinstance(inner, str) and inner.startswith("/"):
                yield inner
            else:
                yield from foxglove_paths(inner)
    elif isinstance(node, list):
        for inner in node:
            yield from foxglove_paths(inner)


def layout_paths(file):
    if file.endswith(".json"):
        with open(file, encoding="utf-8") as text:
            return list(foxglove_paths(json.load(text)))
    curves = ElementTree.parse(file).iter("curve")
    # PlotJuggler separates fields by slashes.
    return [curve.get("name") for curve in curves]


def read(log, schemas, paths):
    """Decodes every message of a log; returns the number of messages of each topic."""
    counts, absent = Counter(), []
    with open(log, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[Protobuf(), Ros2()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            schemas[channel.topic] = schema.name
            values = {}
            flat(message, channel.topic, values)
            paths.update(values)
            absent += [path for path, value in values.items() if isinstance(value, float) and math.isnan(value)]
    if absent:
        sys.exit(f"{log}: NaN in {len(absent)} values, first in {absent[0]}")
    return counts


def main(files):
    logs = [file for file in files if file.endswith(".mcap")]
    layouts = [file for file in files if not file.endswith(".mcap")]
    schemas, paths = {}, set()
    for log in logs:
        print(log)
        for topic, count in sorted(read(log, schemas, paths).items()):
            print(f"{topic}  {schemas[topic]}  {count} messages")
    known = set(schemas) | paths | {re.sub(r"\[\d+\]", "[:]", path) for path in paths}
    slashed = {path.replace(".", "/") for path in paths}
    for layout in layouts:
        missing = [path for path in layout_paths(layout) if path not in known and path not in slashed]
        if missing:
            sys.exit(f"{layout}: in none of the logs: {', '.join(missing)}")
        print(f"{layout}: {len(layout_paths(layout))} topics and fields are in the logs")


if __name__ == "__main__":
    main(sys.argv[1:])
