"""A place in a graph, and the two ends of a topic."""

import ctypes
import os
import re
import signal
import time
import weakref
from typing import Iterator, Optional

import iceoryx2
import numpy
from iceoryx2 import Slice

from . import schema
from .schema import TOPICS
from .topic import Topic, to_dict


class GraphError(Exception):
    """The graph cannot be joined, or a topic not be opened."""


class SchemaMismatch(GraphError):
    """The graph speaks another version of the messages than this module."""


class Graph:
    """A place in a graph, under a name; ends with the `with` block, or when the process is asked to end."""

    def __init__(self, domain: str, name: str, incarnation: int = 0, max_points: int = 1, handle_signals: bool = True):
        self.name, self.incarnation, self.max_points = name, incarnation, max_points
        self._stop = False
        if handle_signals:
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: self.stop())
        iceoryx2.set_log_level(iceoryx2.LogLevel.Fatal)
        root = f"/tmp/mirador-{os.getuid()}/{domain}"
        if not os.path.isdir(root):
            raise GraphError(f"no graph runs in the domain '{domain}': {root} is not there")
        # Never a configuration file of iceoryx2's that happens to lie around.
        config = iceoryx2.config.default()
        config.global_cfg.prefix = iceoryx2.FileName.new(f"mirador.{os.getuid()}.{domain}.")
        config.global_cfg.root_path = iceoryx2.Path.new(f"{root}/")
        self._config = config
        try:
            builder = iceoryx2.NodeBuilder.new().name(iceoryx2.NodeName.new(name)).config(config)
            builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
            self._node = builder.create(iceoryx2.ServiceType.Ipc)
        except Exception as error:
            raise GraphError(f"the domain '{domain}' cannot be joined as '{name}': {error}") from error

    @classmethod
    def from_environment(cls) -> "Graph":
        """The place of a program that the supervisor has started."""
        missing = [key for key in ("MIRADOR_DOMAIN", "MIRADOR_NAME") if key not in os.environ]
        if missing:
            raise GraphError(f"{' and '.join(missing)} not set: this program is started by mirador, as [programs.NAME]")
        incarnation, points = (int(os.environ.get(key, 0)) for key in ("MIRADOR_INCARNATION", "MIRADOR_MAX_POINTS"))
        return cls(os.environ["MIRADOR_DOMAIN"], os.environ["MIRADOR_NAME"], incarnation, points)

    def __enter__(self) -> "Graph":
        return self

    def __exit__(self, *_) -> None:
        self.stop()

    def stop(self) -> None:
        """Ends every loop that listens."""
        self._stop = True

    @property
    def is_stopped(self) -> bool:
        return self._stop

    def subscriber(self, topic: str) -> "Subscriber":
        """The receiving end of a topic."""
        return Subscriber(self, _topic(topic))

    def publisher(self, topic: str) -> "Publisher":
        """The sending end of a topic."""
        return Publisher(self, _topic(topic))

    def _open(self, topic: Topic):
        name = iceoryx2.ServiceName.new(topic.name)
        builder = self._node.service_builder(name).publish_subscribe(Slice[topic.item]).user_header(topic.meta)
        verifier = iceoryx2.AttributeVerifier.new().require(
            iceoryx2.AttributeKey.new("schema_hash"), iceoryx2.AttributeValue.new(topic.schema_hash)
        )
        try:
            return builder.open_with_attributes(verifier)
        except iceoryx2.PublishSubscribeOpenError as error:
            there = self._there(name)
            if there is None:
                raise GraphError(f"topic '{topic.name}' is not there: {error}") from error
            raise SchemaMismatch(
                f"topic '{topic.name}' has another layout: here {topic.meta.TYPE_NAME} of {ctypes.sizeof(topic.meta)} "
                f"bytes, {topic.item.TYPE_NAME} of {ctypes.sizeof(topic.item)} bytes, schema {topic.schema_hash}; "
                f"there {there} ({error}). Use the mirador_messages of the mirador that runs"
            ) from error

    def _there(self, name) -> Optional[str]:
        """What the graph says of a topic."""
        pattern = iceoryx2.MessagingPattern.PublishSubscribe
        details = iceoryx2.Service.details(name, self._config, pattern, iceoryx2.ServiceType.Ipc)
        if details is None:
            return None
        hashes = details.attributes().key_values(iceoryx2.AttributeKey.new("schema_hash"))
        known = [found.group(1) for value in hashes if (found := re.search('"([^"]*)"', str(value)))]
        return f"schema {', '.join(known) or 'unknown'}"

    def _event(self, topic: Topic):
        return self._node.service_builder(iceoryx2.ServiceName.new(topic.name)).event().open()


def _topic(name: str) -> Topic:
    if name not in TOPICS:
        raise GraphError(f"there is no topic '{name}'; there are: {', '.join(TOPICS)}")
    return TOPICS[name]


class Subscriber:
    """The receiving end of a topic."""

    def __init__(self, graph: Graph, topic: Topic):
        self.topic, self._graph = topic, graph
        service = graph._open(topic)
        # The listener first: a message that comes in between wakes it.
        self._listener = graph._event(topic).listener_builder().create()
        try:
            self._port = service.subscriber_builder().create()
        except iceoryx2.SubscriberCreateError as error:
            raise GraphError(f"topic '{topic.name}' takes no further subscriber: {error}") from error

    def receive(self) -> Optional["Message"]:
        """The next message, if there is one."""
        sample = self._port.receive()
        return None if sample is None else Message(self.topic, sample)

    def listen(self, timeout: float = 0.05, idle=None) -> Iterator["Message"]:
        """Message after message, until the graph is stopped; `idle()` is called at least every `timeout` seconds."""
        while not self._graph.is_stopped:
            message = self.receive()
            if idle is not None:
                idle()
            if message is not None:
                yield message
                # Not held while the next is waited for.
                del message
                continue
            try:
                self._listener.timed_wait(iceoryx2.Duration.from_millis(int(timeout * 1000)))
            except iceoryx2.ListenerWaitError:
                # A signal came; whether it was one to stop is looked at above.
                continue


class Publisher:
    """The sending end of a topic."""

    def __init__(self, graph: Graph, topic: Topic):
        self.topic, self._graph, self._sequence = topic, graph, 0
        service = graph._open(topic)
        self.most_items = topic.most_items(graph.max_points)
        builder = service.publisher_builder().initial_max_slice_len(self.most_items)
        builder = builder.allocation_strategy(iceoryx2.AllocationStrategy.Static)
        # A reader that hangs does not hold us up; it sees a gap.
        builder = builder.backpressure_strategy(iceoryx2.BackpressureStrategy.DiscardData)
        try:
            self._port = builder.create()
        except iceoryx2.PublisherCreateError as error:
            raise GraphError(f"topic '{topic.name}' takes no further publisher: {error}") from error
        self._notifier = graph._event(topic).notifier_builder().create()

    def send(self, meta, items) -> None:
        """Sends a message; number, incarnation and time of sending are filled in."""
        if len(items) > self.most_items:
            raise GraphError(f"a message of {len(items)} items does not fit '{self.topic.name}': {self.most_items} at most")
        meta.header.sequence, meta.header.incarnation = self._sequence, self._graph.incarnation
        meta.header.sent_ns = time.monotonic_ns()
        sample = self._port.loan_slice_uninit(len(items))
        ctypes.memmove(sample.user_header_ptr, ctypes.byref(meta), ctypes.sizeof(meta))
        size = ctypes.sizeof(self.topic.item)
        for index, item in enumerate(items):
            ctypes.memmove(sample.payload_ptr + index * size, ctypes.byref(item), size)
        sample.assume_init().send()
        self._sequence += 1
        self._notifier.notify()


class Message:
    """A message where the publisher wrote it."""

    def __init__(self, topic: Topic, sample):
        self.topic = topic
        size, count = ctypes.sizeof(topic.item), sample.header.number_of_elements
        self._meta = _view(sample, sample.user_header_ptr, topic.meta)
        self._items = _view(sample, sample.payload_ptr, topic.item * count)
        assert ctypes.sizeof(self._items) == size * count

    @property
    def meta(self):
        """The meta part, in place."""
        return self._meta

    @property
    def header(self):
        """The header, in place."""
        return self._meta.header

    @property
    def items(self) -> numpy.ndarray:
        """The items as a structured array, in place and not writable: `items["x"]`."""
        array = numpy.frombuffer(self._items, dtype=numpy.dtype(self.topic.item))
        array.flags.writeable = False
        return array

    def to_dict(self) -> dict:
        """Meta and items as plain Python values; copied."""
        return {"meta": to_dict(self._meta), "items": [to_dict(item) for item in self._items]}


# What keeps the samples of views alive: a view that is collected lets its sample go.
def _view(sample, address: int, kind):
    view = kind.from_address(address)
    weakref.finalize(view, _Held(sample).let_go)
    return view


class _Held:
    """A sample, until it is let go."""

    def __init__(self, sample):
        self._sample = sample

    def let_go(self) -> None:
        self._sample = None


class Health:
    """Says how a program is, every 50 ms when asked to: so it is seen in `mirador top`, and missed when it hangs."""

    INTERVAL_S = 0.05

    def __init__(self, graph: Graph):
        self._graph, self._last = graph, 0.0
        self._publisher = graph.publisher("service_health")
        self._record = schema.ServiceHealth()
        self._record.service[:] = _packed(graph.name, 32)
        self._record.pid = os.getpid()
        self.state(schema.SERVICE_STARTING)

    def state(self, state: int, message: str = "") -> None:
        """Says a state, one of the `SERVICE_*` constants, and what the program is doing."""
        self._record.state = state
        self._record.message[:] = _packed(message, 200)
        self._say()

    def finished(self, scans: int, work_s: float = 0.0) -> None:
        """Every scan below this number is done: the acknowledgement that lockstep waits for."""
        self._record.finished_scans, self._record.last_work_ns = scans, int(work_s * 1e9)
        self._say()

    def beat(self) -> None:
        """Says it again when it was last said 50 ms ago."""
        if time.monotonic() - self._last >= self.INTERVAL_S:
            self._say()

    def _say(self) -> None:
        self._last = time.monotonic()
        self._record.cpu_ns = time.process_time_ns()
        with open("/proc/self/statm", encoding="ascii") as statm:
            self._record.resident_bytes = int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        meta = schema.Envelope()
        meta.header.id = self._record.finished_scans
        meta.header.began_ns = time.monotonic_ns()
        self._publisher.send(meta, [self._record])


def _packed(words: str, size: int):
    encoded = words.encode()[:size].decode("utf-8", "ignore").encode()
    return encoded.ljust(size, b"\0")


def place_of(array: numpy.ndarray):
    """Inode and offset of the shared-memory file in which an array lies: two processes that find the same place look at
    the same bytes. `None` when it lies in no file."""
    address = array.__array_interface__["data"][0]
    with open("/proc/self/maps", encoding="ascii") as maps:
        for line in maps:
            span, _, offset, _, inode = line.split()[:5]
            begin, end = (int(x, 16) for x in span.split("-"))
            if begin <= address < end:
                return None if inode == "0" else (int(inode), int(offset, 16) + address - begin)
    return None
