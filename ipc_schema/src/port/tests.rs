//! The ports over real shared memory, both ends in one process, each test in a domain of its own.

use std::os::unix::fs::MetadataExt;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::*;
use crate::messages::{Envelope, Header, Point, PoseEstimate, ScanMeta, ServiceHealth};
use crate::topics::{self, Sizes, Topic};
use crate::{Domain, budget};

/// A domain of its own that leaves nothing, also when the test fails.
struct TestDomain(Domain);

impl TestDomain {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("u{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        Self(Domain::new(&name).unwrap())
    }

    fn join(&self, service: &str, points: usize, wake: Wake) -> Participant {
        let sizes = Sizes { scan_points: points };
        Participant::join(self.0.clone(), service, 0, sizes, wake, StopSignal::default()).unwrap()
    }
}

impl Drop for TestDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_all();
    }
}

fn send_scan(publisher: &Publisher<topics::Scan>, scan: u64, points: usize) {
    let mut loan = publisher.loan(points).unwrap();
    *loan.meta_mut() = ScanMeta { header: Header::new(scan, 0), ..ScanMeta::default() };
    for (i, point) in loan.items_mut().iter_mut().enumerate() {
        *point = Point { x: i as f32, ..Point::default() };
    }
    loan.send().unwrap();
}

#[test]
fn a_scan_is_read_where_it_was_written() {
    let domain = TestDomain::new();
    let here = domain.join("writer", 100, Wake::Event);
    let there = domain.join("reader", 100, Wake::Event);
    let publisher = here.publisher::<topics::Scan>().unwrap();
    let subscriber = there.subscriber::<topics::Scan>().unwrap();
    let mut loan = publisher.loan(100).unwrap();
    *loan.meta_mut() = ScanMeta { header: Header::new(7, 0), ..ScanMeta::default() };
    loan.items_mut().fill(Point { x: 3.0, ..Point::default() });
    let written = loan.location().unwrap();
    loan.send().unwrap();
    let received = subscriber.receive().unwrap().unwrap();
    assert_eq!(received.location(), Some(written), "same inode, same offset");
    assert_eq!(received.header().id, 7);
    assert!(received.items().iter().all(|p| p.x == 3.0) && received.items().len() == 100);
    assert_eq!(there.counters().copied_payload_bytes.get(), 0);
}

#[test]
fn bytes_that_are_copied_are_counted() {
    let domain = TestDomain::new();
    let participant = domain.join("both", 10, Wake::Event);
    let publisher = participant.publisher::<topics::Scan>().unwrap();
    let subscriber = participant.subscriber::<topics::Scan>().unwrap();
    publisher.send_copy(ScanMeta::default(), &[Point::default(); 10]).unwrap();
    assert_eq!(participant.counters().copied_payload_bytes.get(), 160);
    let copy = subscriber.receive().unwrap().unwrap().copy_items();
    assert_eq!(copy.len(), 10);
    assert_eq!(participant.counters().copied_payload_bytes.get(), 320);
}

#[test]
fn a_message_larger_than_the_slot_is_refused_with_the_key_to_raise() {
    let domain = TestDomain::new();
    let participant = domain.join("writer", 10, Wake::Event);
    let publisher = participant.publisher::<topics::Scan>().unwrap();
    let message = publisher.loan(11).err().unwrap().to_string();
    assert!(message.contains("11 items") && message.contains("graph.max_points"), "{message}");
}

#[test]
fn a_reader_that_lags_on_a_sensor_stream_counts_what_it_missed() {
    let domain = TestDomain::new();
    let participant = domain.join("both", 10, Wake::Event);
    let publisher = participant.publisher::<topics::Pose>().unwrap();
    let subscriber = participant.subscriber::<topics::Pose>().unwrap();
    let send = |n: u64| publisher.send_one(Envelope { header: Header::new(n, 0) }, PoseEstimate::default()).unwrap();
    send(0);
    assert!(subscriber.receive().unwrap().is_some());
    let buffer = <topics::Pose as Topic>::RULES.buffer as u64;
    (1..=buffer + 5).for_each(send);
    let mut seen = 0;
    while subscriber.receive().unwrap().is_some() {
        seen += 1;
    }
    assert_eq!(seen, buffer);
    assert_eq!(participant.counters().lost.get(), 5);
}

#[test]
fn a_late_joiner_gets_the_history() {
    let domain = TestDomain::new();
    let participant = domain.join("both", 10, Wake::Event);
    let publisher = participant.publisher::<topics::Scan>().unwrap();
    send_scan(&publisher, 3, 10);
    send_scan(&publisher, 4, 10);
    let subscriber = participant.subscriber::<topics::Scan>().unwrap();
    publisher.serve_late_joiners();
    assert_eq!(subscriber.receive().unwrap().unwrap().header().id, 4);
    assert!(subscriber.receive().unwrap().is_none());
    assert_eq!(participant.counters().lost.get(), 0, "what came before was never meant for it");
}

#[test]
fn every_slot_is_allocated_at_the_start_and_fits_the_budget() {
    let domain = TestDomain::new();
    let points = 5_000;
    let participant = domain.join("acquisition", points, Wake::Event);
    let _scan = participant.publisher::<topics::Scan>().unwrap();
    let segments: Vec<_> = domain.0.segments();
    let data: Vec<_> = segments.iter().filter(|p| p.extension().is_some_and(|e| e == "data")).collect();
    let (mut size, mut allocated) = (0, 0);
    for path in data {
        let meta = std::fs::metadata(path).unwrap();
        size += meta.size();
        allocated += meta.blocks() * 512;
    }
    assert!(allocated >= size && size > 0);
    let memory = budget::of_graph(&["acquisition"], &Sizes { scan_points: points });
    let planned = memory.iter().find(|m| m.topic == "scan").unwrap().bytes();
    assert!(size <= planned, "{size} bytes taken, {planned} planned");
    assert!(size * 2 > planned, "the budget asks for far more than is taken: {planned} for {size}");
}

#[test]
fn a_domain_of_the_longest_name_can_be_used() {
    let name = format!("long{}{}", std::process::id(), "x".repeat(30));
    let longest = (1..name.len()).rev().find_map(|length| Domain::new(&name[..length]).ok()).unwrap();
    let domain = TestDomain(longest);
    let here = domain.join("a-service-of-a-long-name", 10, Wake::Event);
    let subscriber = here.subscriber::<topics::RegistrationRequest>().unwrap();
    let publisher = here.publisher::<topics::RegistrationRequest>().unwrap();
    publisher.send_copy(Default::default(), &[]).unwrap();
    assert!(subscriber.receive().unwrap().is_some());
}

#[test]
fn two_domains_do_not_hear_each_other() {
    let (one, two) = (TestDomain::new(), TestDomain::new());
    let (a, b) = (one.join("a", 10, Wake::Event), two.join("b", 10, Wake::Event));
    let publisher = a.publisher::<topics::Scan>().unwrap();
    let subscriber = b.subscriber::<topics::Scan>().unwrap();
    send_scan(&publisher, 1, 10);
    assert!(subscriber.receive().unwrap().is_none());
}

#[test]
fn a_message_wakes_a_sleeping_reader_and_a_polling_one() {
    for wake in [Wake::Event, Wake::Poll] {
        let domain = TestDomain::new();
        let reader = domain.join("reader", 10, wake);
        let subscriber = reader.subscriber::<topics::Scan>().unwrap();
        let other = domain.0.clone();
        let sender = std::thread::spawn(move || {
            let sizes = Sizes { scan_points: 10 };
            let writer = Participant::join(other, "writer", 0, sizes, Wake::Event, StopSignal::default()).unwrap();
            let publisher = writer.publisher::<topics::Scan>().unwrap();
            std::thread::sleep(Duration::from_millis(50));
            send_scan(&publisher, 1, 10);
            // The sample outlives the writer only while somebody is connected to it.
            std::thread::sleep(Duration::from_millis(300));
        });
        let mut found = false;
        // A sleeping reader hears of the writer's birth only with its first message.
        for _ in 0..200 {
            if subscriber.receive_within(&reader, Duration::from_millis(20)).unwrap().is_some() {
                found = true;
                break;
            }
        }
        sender.join().unwrap();
        assert!(found, "{wake:?}");
    }
}

#[test]
fn a_wait_ends_with_the_wish_to_stop() {
    let domain = TestDomain::new();
    let participant = domain.join("reader", 10, Wake::Event);
    let subscriber = participant.subscriber::<topics::Scan>().unwrap();
    participant.stop().set();
    // Would be noticed by the test runner if it took the hour.
    participant.wait(&[&subscriber], Duration::from_secs(3600));
}

#[test]
fn two_layouts_of_one_topic_are_told_apart_with_both_sides() {
    struct Other;
    impl Topic for Other {
        type Meta = Envelope;
        type Item = ServiceHealth;
        const RULES: topics::Rules = <topics::Scan as Topic>::RULES;
    }
    let domain = TestDomain::new();
    let participant = domain.join("both", 10, Wake::Event);
    let _publisher = participant.publisher::<topics::Scan>().unwrap();
    let message = participant.subscriber::<Other>().err().unwrap().to_string();
    assert!(message.contains("here 48 bytes of meta") && message.contains("there 120 bytes of meta"), "{message}");
    assert!(message.contains("mirador/Point/1"), "{message}");
}

#[test]
fn a_topic_takes_no_more_publishers_than_its_rules_say() {
    let domain = TestDomain::new();
    let participant = domain.join("both", 10, Wake::Event);
    let _first = participant.publisher::<topics::Scan>().unwrap();
    let message = participant.publisher::<topics::Scan>().err().unwrap().to_string();
    assert!(message.contains("'scan' takes no further publisher"), "{message}");
}

#[test]
fn a_publisher_waits_for_a_busy_reader_that_was_there_before_it_once_that_is_connected() {
    let domain = TestDomain::new();
    let (here, there) = (domain.join("writer", 10, Wake::Event), domain.join("reader", 10, Wake::Event));
    let subscriber = there.subscriber::<topics::Scan>().unwrap();
    let publisher = here.publisher::<topics::Scan>().unwrap();
    there.connect();
    let count = topics::Scan::RULES.buffer as u64 + 3;
    let received = std::thread::scope(|scope| {
        scope.spawn(move || (0..count).for_each(|scan| send_scan(&publisher, scan, 10)));
        // Busy with something else while the buffer fills.
        std::thread::sleep(Duration::from_millis(100));
        let take = |_| subscriber.receive_within(&there, Duration::from_secs(1)).unwrap().map(|m| m.header().id);
        (0..count).map_while(take).collect::<Vec<_>>()
    });
    assert_eq!(received, (0..count).collect::<Vec<_>>());
}
