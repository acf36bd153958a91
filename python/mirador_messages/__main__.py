"""`python -m mirador_messages DOMAIN [TOPIC] [--count N] [--items N]`: what a graph says, a JSON object a line."""

import argparse
import json
import sys

from . import TOPICS, Graph, GraphError, to_dict


def main() -> int:
    parser = argparse.ArgumentParser(prog="mirador_messages", description="Prints what a running mirador says.")
    parser.add_argument("domain", help="the graph's domain, `mirador` unless it was given another")
    parser.add_argument("topic", nargs="?", help="the topic to listen to; without one the topics are listed")
    parser.add_argument("--count", type=int, default=0, help="end after so many messages; 0 goes on")
    parser.add_argument("--items", type=int, default=0, help="print so many items of each message")
    given = parser.parse_args()
    if given.topic is None:
        for topic in TOPICS.values():
            print(f"{topic.name}: {topic.meta.TYPE_NAME} [{topic.item.TYPE_NAME}], schema {topic.schema_hash}")
        return 0
    try:
        with Graph(given.domain, "listener") as graph:
            for number, message in enumerate(graph.subscriber(given.topic).listen(), 1):
                line = {"topic": given.topic, "meta": to_dict(message.meta), "items": len(message.items)}
                if given.items:
                    line["first"] = message.to_dict()["items"][: given.items]
                print(json.dumps(line), flush=True)
                if number == given.count:
                    break
    except GraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
