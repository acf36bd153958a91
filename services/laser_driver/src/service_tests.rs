use super::*;
use crate::emulator::{Emulator, Manner};
use mirador_ipc_schema::messages::{Envelope, ScanRequest, ServiceHealth};
use mirador_ipc_schema::topics::Sizes;
use mirador_ipc_schema::{Domain, StopSignal, Wake, text};
use proptest::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// A listener in a domain of its own, where a driver speaks to an emulated device.
struct Stage {
    domain: Domain,
    participant: Participant,
    sweeps: Subscriber<topics::LaserSweep>,
    health: Subscriber<topics::ServiceHealth>,
    requests: Publisher<topics::ScanRequests>,
}

#[derive(Debug, Clone)]
struct Heard {
    meta: LaserSweepMeta,
    beams: Vec<Beam>,
}

impl Stage {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("laser{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let domain = Domain::new(&name).unwrap();
        let sizes = Sizes { scan_points: 10 };
        let participant =
            Participant::join(domain.clone(), "listener", 0, sizes, Wake::Event, StopSignal::default()).unwrap();
        let (sweeps, health) = (participant.subscriber().unwrap(), participant.subscriber().unwrap());
        let requests = participant.publisher().unwrap();
        Self { domain, participant, sweeps, health, requests }
    }

    /// Runs the driver on a device until `is_enough` says so; what was heard of sweeps and health.
    fn listen(
        &self,
        device: &Emulator,
        mut is_enough: impl FnMut(&[Heard], &[ServiceHealth]) -> bool,
    ) -> (Vec<Heard>, Vec<ServiceHealth>) {
        let stop = StopSignal::default();
        let folder = tempfile::tempdir().unwrap();
        let setup = ServiceSetup {
            name: "laser_driver".into(),
            domain: self.domain.clone(),
            incarnation: 0,
            sizes: Sizes { scan_points: 10 },
            wake: Wake::Event,
            run_dir: folder.path().to_owned(),
            run: 3,
            threads: 1,
            stop: stop.clone(),
        };
        let config = LaserDriverConfig {
            address: device.address.to_string(),
            silence_s: 0.2,
            retry_s: 0.02,
            ..LaserDriverConfig::default()
        };
        let driver = std::thread::spawn(move || run(&setup, &config).map_err(|e| e.to_string()));
        let (mut heard, mut healths) = (Vec::new(), Vec::new());
        let begin = Instant::now();
        while !is_enough(&heard, &healths) {
            assert!(begin.elapsed() < Duration::from_secs(20), "never enough: {} sweeps, {healths:?}", heard.len());
            self.participant.wait(&[&self.sweeps, &self.health], Duration::from_millis(5));
            while let Some(message) = self.sweeps.receive().unwrap() {
                heard.push(Heard { meta: *message.meta(), beams: message.items().to_vec() });
            }
            while let Some(message) = self.health.receive().unwrap() {
                healths.extend_from_slice(message.items());
            }
        }
        stop.set();
        driver.join().unwrap().unwrap();
        (heard, healths)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        let _ = self.domain.remove_all();
    }
}

fn said(healths: &[ServiceHealth], words: &str) -> bool {
    healths.iter().any(|health| text::unpack(&health.message).contains(words))
}

#[test]
fn sweeps_come_out_as_the_device_says_them_however_they_are_cut() {
    for piece in [0, 7, 61] {
        let device = Emulator::start(Manner { piece, warm_up_looks: 2, ..Manner::default() });
        let (heard, _) = Stage::new().listen(&device, |heard, _| heard.len() >= 60);
        for pair in heard.windows(2) {
            assert_eq!(pair[1].meta.sweep, pair[0].meta.sweep + 1, "the counter of the device wraps, ours does not");
            assert!(pair[1].meta.header.stamp_ns > pair[0].meta.header.stamp_ns);
        }
        let Heard { meta, beams } = &heard[0];
        assert_eq!((meta.header.clock_id, meta.header.scan()), (REALTIME, u32::MAX));
        assert!(
            (meta.first_angle.to_degrees() + 45.0).abs() < 1e-9 && (meta.angle_step.to_degrees() - 0.5).abs() < 1e-9
        );
        // Two steps of half a degree at 50 turns a second.
        assert_eq!(meta.duration_ns, 55_555);
        assert!(beams[0].range.is_nan(), "no return is no range");
        assert_eq!((beams[1].range, beams[2].range), (1.5, 20.0));
        assert_eq!((beams[1].intensity, beams[2].time), (0xFE, 65535));
    }
}

#[test]
fn lost_repeated_and_garbled_sweeps_are_counted_and_the_rest_goes_on() {
    let manner = Manner { garble_every: 7, skip_every: 5, repeat_every: 3, ..Manner::default() };
    let device = Emulator::start(manner);
    let (heard, healths) = Stage::new()
        .listen(&device, |heard, healths| heard.len() > 40 && said(healths, "missing") && said(healths, "repeated"));
    assert!(heard.windows(2).all(|pair| pair[1].meta.sweep > pair[0].meta.sweep), "none twice, none out of order");
    let last = text::unpack(&healths.last().unwrap().message).to_owned();
    assert!(
        last.contains("sweeps missing") && last.contains("telegrams passed over") && !last.contains(" 0 telegrams"),
        "{last}"
    );
}

#[test]
fn a_device_that_hangs_up_or_falls_silent_is_named_and_connected_to_again() {
    for (manner, words) in [
        (Manner { hang_up_after: 10, ..Manner::default() }, "closed the connection"),
        (Manner { fall_silent_after: 10, ..Manner::default() }, "did not answer"),
    ] {
        let device = Emulator::start(manner);
        let (heard, healths) = Stage::new().listen(&device, |heard, healths| heard.len() > 15 && said(healths, words));
        assert!(device.connections.load(Ordering::Relaxed) >= 2);
        assert!(heard.windows(2).all(|pair| pair[1].meta.sweep > pair[0].meta.sweep), "{words}");
        assert!(said(&healths, &device.address.to_string()), "the device is named");
    }
}

#[test]
fn a_device_that_refuses_is_named_with_its_answer() {
    let device = Emulator::start(Manner { refuses: true, ..Manner::default() });
    let (heard, _) = Stage::new().listen(&device, |_, healths| said(healths, "answered 'sAN SetAccessMode 0'"));
    assert!(heard.is_empty());
}

#[test]
fn sweeps_carry_the_scan_that_was_asked_for_last() {
    let device = Emulator::start(Manner::default());
    let stage = Stage::new();
    let ask = |scan: u32| {
        let request = ScanRequest { kind: ScanRequestKind::TAKE, scan, reserved: 0 };
        stage.requests.send_one(Envelope { header: Header::new(0, 0) }, request).unwrap();
    };
    let mut asked = false;
    let (heard, _) = stage.listen(&device, |heard, _| {
        if !asked && heard.len() > 5 {
            ask(4);
            asked = true;
        }
        heard.last().is_some_and(|h| h.meta.header.scan() == 4)
    });
    assert_eq!(ScanId::unpack(heard.last().unwrap().meta.header.id).run, 3);
}

proptest! {
    #[test]
    fn sweep_numbers_only_grow(counters in prop::collection::vec(any::<u16>(), 1..60)) {
        let mut count = SweepCount::default();
        let numbers: Vec<u32> = counters.iter().filter_map(|c| count.next(*c)).collect();
        prop_assert!(numbers.windows(2).all(|pair| pair[1] > pair[0]));
        prop_assert_eq!(numbers.len() as u64 + count.repeated, counters.len() as u64);
    }
}
