"""Tests of mirador_messages against a graph that runs: its domain is in MIRADOR_TEST_DOMAIN."""

import ctypes
import dataclasses
import gc
import os
import time
import unittest

import mirador_messages as mirador
from mirador_messages import schema

DOMAIN = os.environ["MIRADOR_TEST_DOMAIN"]


def next_of(subscriber):
    for _ in range(2000):
        message = subscriber.receive()
        if message is not None:
            return message
        time.sleep(0.005)
    raise AssertionError(f"nothing came on {subscriber.topic.name}")


class Layouts(unittest.TestCase):
    def test_every_record_has_the_size_that_the_graph_says(self):
        records = {record for topic in mirador.TOPICS.values() for record in (topic.meta, topic.item)}
        self.assertGreater(len(records), 30)
        for record in records:
            self.assertEqual(ctypes.sizeof(record), record.SIZE, record)

    def test_text_and_lists_come_out_of_records(self):
        health = schema.ServiceHealth(finished_scans=3)
        health.service[:] = b"planning".ljust(32, b"\0")
        self.assertEqual(mirador.text(health.service), "planning")
        self.assertEqual(mirador.to_dict(health)["finished_scans"], 3)


class Listening(unittest.TestCase):
    def setUp(self):
        self.graph = mirador.Graph(DOMAIN, "tests", handle_signals=False)

    def test_every_topic_can_be_opened(self):
        for topic in mirador.TOPICS:
            subscriber = self.graph.subscriber(topic)
            self.assertEqual(subscriber.topic.name, topic)
            del subscriber

    def test_a_scan_is_read_where_acquisition_wrote_it(self):
        first, second = self.graph.subscriber("scan"), self.graph.subscriber("scan")
        scans = {}
        for subscriber in (first, second):
            for _ in range(2):
                message = next_of(subscriber)
                scans.setdefault(message.header.id, []).append(mirador.place_of(message.items))
                del message
        twice = [places for places in scans.values() if len(places) == 2]
        self.assertTrue(twice, scans)
        for one, other in twice:
            self.assertIsNotNone(one)
            self.assertEqual(one, other)

    def test_points_are_those_of_the_scan_and_cannot_be_written(self):
        message = next_of(self.graph.subscriber("scan"))
        points = message.items
        self.assertEqual(len(points), message.meta.rows * message.meta.cols)
        returns = int((points["x"] == points["x"]).sum())
        self.assertEqual(returns, message.meta.returns)
        with self.assertRaises(ValueError):
            points["x"][0] = 1.0

    def test_a_view_keeps_its_message_and_lets_it_go_with_itself(self):
        subscriber = self.graph.subscriber("clock")
        views, copies = [], []
        for _ in range(2):
            message = next_of(subscriber)
            views.append(message.items["reserved"])
            copies.append(views[-1].copy())
            del message
        gc.collect()
        # Two views hold two messages, all that a reader may hold.
        with self.assertRaises(Exception) as caught:
            next_of(subscriber)
        self.assertIn("ExceedsMaxBorrows", str(caught.exception))
        for view, copy in zip(views, copies):
            self.assertTrue((view == copy).all(), "what a view shows stays")
        del view
        views.clear()
        gc.collect()
        self.assertIsNotNone(next_of(subscriber))

    def test_another_schema_is_told_with_both_sides(self):
        right = mirador.TOPICS["registration_request"]
        self.graph.subscriber("registration_request")

        class OldMeta(mirador.Record):
            TYPE_NAME = "mirador/RegistrationRequestMeta/0"
            _fields_ = [("header", schema.Header)]

        wrong = {
            "hash": dataclasses.replace(right, schema_hash="0123456789abcdef"),
            "type": dataclasses.replace(right, meta=OldMeta, schema_hash="0123456789abcdef"),
        }
        for name, topic in wrong.items():
            mirador.TOPICS["registration_request"] = topic
            try:
                with self.assertRaises(mirador.SchemaMismatch) as caught:
                    self.graph.subscriber("registration_request")
            finally:
                mirador.TOPICS["registration_request"] = right
            self.assertIn("0123456789abcdef", str(caught.exception), name)
            self.assertIn(right.schema_hash, str(caught.exception), name)

    def test_a_topic_that_is_not_there_is_told(self):
        with self.assertRaisesRegex(mirador.GraphError, "no topic 'scam'"):
            self.graph.subscriber("scam")

    def test_a_domain_without_a_graph_is_told(self):
        with self.assertRaisesRegex(mirador.GraphError, "no graph runs"):
            mirador.Graph("nobody-here", "tests", handle_signals=False)

    def test_health_that_is_said_is_heard(self):
        subscriber = self.graph.subscriber("service_health")
        health = mirador.Health(self.graph)
        health.state(schema.SERVICE_RUNNING, "testing")
        for _ in range(500):
            message = next_of(subscriber)
            heard = mirador.to_dict(message.meta), mirador.to_dict(message._items[0])
            del message
            if heard[1]["service"] == "tests" and heard[1]["message"] == "testing":
                self.assertEqual((heard[1]["pid"], heard[1]["state"]), (os.getpid(), schema.SERVICE_RUNNING))
                return
        self.fail("not heard")


if __name__ == "__main__":
    unittest.main()
