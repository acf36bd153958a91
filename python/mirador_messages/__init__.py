"""Listen to and speak with a running mirador from Python, in place, over shared memory.

    import mirador_messages as mirador

    with mirador.Graph("mirador", "watcher") as graph:
        for message in graph.subscriber("scan").listen():
            print(message.header.id, message.items["z"].mean())

`message.meta` and `message.items` lie where the publisher wrote them; nothing is copied. As long as a view of them
exists its message stays in shared memory, so that no view outlives what it shows; drop them before the next messages
are needed, of which a reader may hold two of a topic.

A graph of another version is told at the door: `SchemaMismatch` names both sides.
"""

from . import schema
from .graph import Graph, GraphError, Health, Message, Publisher, SchemaMismatch, Subscriber, place_of
from .schema import TOPICS
from .topic import Record, Topic, text, to_dict

__all__ = [
    "Graph", "GraphError", "Health", "Message", "Publisher", "Record", "SchemaMismatch", "Subscriber", "TOPICS",
    "Topic", "place_of", "schema", "text", "to_dict",
]
