//! The first process: the publisher, which leads the run.

use std::collections::BTreeMap;
use std::os::unix::net::UnixListener;
use std::time::{Duration, Instant};

use mirador_ipc_schema::budget::shared_memory_space;
use mirador_ipc_schema::topics::Topic;
use mirador_ipc_schema::{Domain, Participant, Sizes, Wake};
use serde_json::{Value, json};

use super::bare::BareNode;
use super::case::{COPIED, Case, IN_PLACE, ITEM_BYTES, Pair};
use super::load::Load;
use super::payload::{fill, point};
use super::peer::{Report, Series, socket_path};
use super::peer_process::PeerProcess;
use super::send::{Send, SendBytes, SendIceoryx2, SendMirador};
use super::topic::MeasuredScan;
use super::{BenchError, IpcOptions, Payload, Transport, pin};
use crate::{BenchReport, Machine, Provenance, Row, Summary};

/// Measures every case of `options`, one after the other.
///
/// # Errors
/// See [`BenchError`]. Nothing is left in shared memory or on disk, also then.
pub fn run(options: &IpcOptions) -> Result<BenchReport, BenchError> {
    options.validate()?;
    // Before this thread is pinned, which would show as a machine of one core.
    let machine = Machine::here();
    let domain = OwnDomain::claim(options.domain()?)?;
    let rows = run_cases(options, &domain.0);
    let removed = domain.remove();
    let report = BenchReport { bench: "ipc".into(), machine, rows: rows? };
    removed?;
    Ok(report)
}

/// A domain nobody else uses, removed when dropped.
struct OwnDomain(Domain);

impl OwnDomain {
    fn claim(domain: Domain) -> Result<Self, BenchError> {
        if Domain::existing().contains(&domain) {
            return Err(BenchError::DomainInUse { domain: domain.name().into() });
        }
        Ok(Self(domain))
    }

    fn remove(self) -> Result<(), BenchError> {
        self.0.remove_all()?;
        Ok(())
    }
}

impl Drop for OwnDomain {
    fn drop(&mut self) {
        // Removed already unless the run panicked; an error was then reported by `remove`.
        let _ = self.0.remove_all();
    }
}

fn run_cases(options: &IpcOptions, domain: &Domain) -> Result<Vec<Row>, BenchError> {
    let cores = pin::two_cores();
    let _restore = pin::Restore::now();
    if let Some((publisher, _)) = cores {
        pin::pin(publisher);
    } else {
        tracing::warn!("one core only: every hop includes a switch between the two processes");
    }
    let busy_cores: Vec<usize> = cores.map_or_else(|| vec![0], |(a, b)| vec![a, b]);
    let mut rows = Rows::default();
    let groups = options.payloads.iter().flat_map(|p| options.subscribers.iter().map(move |n| (p, *n)));
    for (payload, subscribers, loaded) in groups.flat_map(|(p, n)| options.loaded.iter().map(move |l| (p, n, *l))) {
        let _load = loaded.then(|| Load::start(&busy_cores));
        let case = |pair: Pair, wake: Wake| Case {
            loaded,
            subscribers,
            domain: domain.name().into(),
            pair,
            poll: wake == Wake::Poll,
            points: payload.bytes / ITEM_BYTES,
            written_before: payload.written_before,
            warm_up: options.warm_up,
            rounds: options.warm_up + payload.messages,
            subscriber_core: cores.map(|(_, subscriber)| subscriber),
        };
        check_space(payload)?;
        for wake in &options.wakes {
            rows.add(&run_case(options, domain, case(IN_PLACE, *wake))?);
        }
        if options.copies && payload.written_before == 0 {
            rows.add(&run_case(options, domain, case(COPIED, Wake::Event))?);
        }
    }
    Ok(rows.sorted())
}

/// A full `/dev/shm` would end the process at the first write, so it is asked before.
fn check_space(payload: &Payload) -> Result<(), BenchError> {
    let (free, _) = shared_memory_space()
        .map_err(|error| BenchError::BadOption { field: "payloads", reason: error.to_string() })?;
    // Two publishers; 4 KiB a slot and 1 MiB in all are more than iceoryx2 adds.
    let needed = 2 * MeasuredScan::RULES.slots() as u64 * (payload.bytes as u64 + 4096) + (1 << 20);
    if needed > free {
        return Err(BenchError::NoSharedMemory { free, needed, payload_bytes: payload.bytes });
    }
    Ok(())
}

/// What one case found [ns], for each transport of its pair.
struct Measured {
    case: Case,
    /// Of every subscriber.
    latency: Vec<[Series; 2]>,
    write: [Vec<u64>; 2],
    send: [Vec<u64>; 2],
}

fn run_case(options: &IpcOptions, domain: &Domain, case: Case) -> Result<Measured, BenchError> {
    tracing::info!(bytes = case.payload_bytes(), poll = case.poll, pair = ?case.pair, "measuring");
    let (mut peers, mut senders) = connect(options, domain, &case)?;
    let rounds = usize::try_from(case.rounds).unwrap_or(0);
    let (mut write, mut send) =
        ([(); 2].map(|()| Vec::with_capacity(rounds)), [(); 2].map(|()| Vec::with_capacity(rounds)));
    let mut elsewhere = vec![point(1, 1); case.written_before / ITEM_BYTES];
    let mut pace = Pace { next: Instant::now(), step: options.pace };
    for (round, place) in case.turns() {
        pace.wait();
        if options.stop.is_set() {
            return Err(BenchError::Interrupted);
        }
        // Between two messages, so that a subscriber that died is told from one that lags.
        for peer in &mut peers {
            if let Some(status) = peer.ended() {
                return Err(peer.failed(format!("it ended with {status}")));
            }
        }
        fill(&mut elsewhere, round);
        std::hint::black_box(&elsewhere);
        let sent = senders[place].send(round)?;
        if round >= case.warm_up {
            write[place].push(sent.write_ns);
            send[place].push(sent.send_ns);
        }
    }
    let mut latency = Vec::new();
    for mut peer in peers {
        let Report::Latencies(of_pair) = peer.next_report(|| options.stop.is_set())? else {
            return Err(peer.failed("it reports twice that it is ready".into()));
        };
        peer.finish()?;
        let expected = case.rounds - case.warm_up;
        for (transport, series) in case.pair.into_iter().zip(&of_pair) {
            if series.latency.len() as u64 != expected {
                let found = format!("{} of {expected} messages were reported", series.latency.len());
                return Err(BenchError::Lost { transport, expected, found });
            }
        }
        latency.push(of_pair);
    }
    Ok(Measured { case, latency, write, send })
}

/// The subscribers' processes, and the sending end of each transport.
type Connected = (Vec<PeerProcess>, [Box<dyn Send>; 2]);

/// Opens the sending ends, starts the subscribers and waits until their receiving ends are open.
fn connect(options: &IpcOptions, domain: &Domain, case: &Case) -> Result<Connected, BenchError> {
    let start = || {
        let mut peer = PeerProcess::start(&options.peer_command, case)?;
        match peer.next_report(|| options.stop.is_set())? {
            Report::Ready => Ok(peer),
            Report::Latencies(_) => Err(peer.failed("it reports latencies before the first message".into())),
        }
    };
    if case.pair == IN_PLACE {
        let senders = open_in_place(domain, case)?;
        let peers = (0..case.subscribers).map(|_| start()).collect::<Result<_, _>>()?;
        return Ok((peers, senders));
    }
    // The socket lies in the domain's folder, which this makes.
    domain.config()?;
    let path = socket_path(domain);
    let listener = UnixListener::bind(&path).map_err(BenchError::io("bind the Unix socket"))?;
    let (mut peers, mut sockets, mut pipes) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..case.subscribers {
        let mut peer = start()?;
        // It is connected by now, so this does not block.
        sockets.push(listener.accept().map_err(BenchError::io("accept a subscriber"))?.0);
        pipes.push(peer.take_stdin()?);
        peers.push(peer);
    }
    std::fs::remove_file(&path).map_err(BenchError::io("remove the Unix socket"))?;
    // Points that are not zero: zeroed memory is mapped only at its first use.
    let points = || vec![point(1, 1); case.points];
    let senders: [Box<dyn Send>; 2] = [
        Box::new(SendBytes { streams: sockets, points: points() }),
        Box::new(SendBytes { streams: pipes, points: points() }),
    ];
    Ok((peers, senders))
}

fn open_in_place(domain: &Domain, case: &Case) -> Result<[Box<dyn Send>; 2], BenchError> {
    let points = case.points;
    let (publisher, notifier) = BareNode::join(domain, "bench-publisher")?.publisher(points, case.wake())?;
    let bare = SendIceoryx2 { publisher, notifier, points };
    // Ours comes second: when it opens it makes all segments of the domain resident, the bare one's too.
    let sizes = Sizes { scan_points: points };
    let stop = mirador_ipc_schema::StopSignal::default();
    let participant = Participant::join(domain.clone(), "bench-publisher", 0, sizes, case.wake(), stop)?;
    Ok([Box::new(SendMirador { publisher: participant.publisher()?, points }), Box::new(bare)])
}

/// One message every `step`; a message that took longer delays those behind it, they do not crowd.
struct Pace {
    next: Instant,
    step: Duration,
}

impl Pace {
    fn wait(&mut self) {
        let now = Instant::now();
        std::thread::sleep(self.next.saturating_duration_since(now));
        self.next = self.next.max(now) + self.step;
    }
}

/// The rows, by kind.
#[derive(Default)]
struct Rows {
    hop: Vec<Row>,
    last: Vec<Row>,
    ratio: Vec<Row>,
    wake_up: Vec<Row>,
    transport: Vec<Row>,
    write: Vec<Row>,
    send: Vec<Row>,
}

impl Rows {
    fn add(&mut self, measured: &Measured) {
        let case = &measured.case;
        let all = [0, 1].map(|place| together(measured.latency.iter().map(|pair| &pair[place])));
        let hops = all.each_ref().map(|series| Summary::of_ns_in_us(&series.latency));
        for (place, transport) in case.pair.into_iter().enumerate() {
            let transport = Some(transport);
            self.hop.extend(hops[place].clone().map(|s| row("hop", "us", case, transport, s)));
            if case.subscribers > 1 {
                let last = Summary::of_ns_in_us(&last_of(measured.latency.iter().map(|pair| &pair[place])));
                self.last.extend(last.map(|s| row("hop_last", "us", case, transport, s)));
            }
            if case.pair == IN_PLACE {
                let slept = Summary::of_ns_in_us(&all[place].wake_up);
                self.wake_up.extend(slept.map(|s| row("wake_up", "us", case, transport, s)));
                let transfer = Summary::of_ns_in_us(&transfer(&all[place]));
                self.transport.extend(transfer.map(|s| row("transport", "us", case, transport, s)));
            }
            let write = Summary::of_ns_in_us(&measured.write[place]);
            self.write.extend(write.map(|s| row("payload_write", "us", case, transport, s)));
            let send = Summary::of_ns_in_us(&measured.send[place]);
            self.send.extend(send.map(|s| row("send_call", "us", case, transport, s)));
        }
        if let ([Some(ours), Some(bare)], true) = (hops, case.pair == IN_PLACE) {
            self.ratio.push(row("hop_ratio", "1", case, None, ours.over(&bare)));
        }
    }

    fn sorted(self) -> Vec<Row> {
        [self.hop, self.last, self.ratio, self.wake_up, self.transport, self.write, self.send]
            .into_iter()
            .flatten()
            .collect()
    }
}

/// What all subscribers saw of one transport.
fn together<'a>(all: impl Iterator<Item = &'a Series>) -> Series {
    let mut sum = Series::default();
    for series in all {
        sum.latency.extend_from_slice(&series.latency);
        sum.wake_up.extend_from_slice(&series.wake_up);
    }
    sum
}

/// For every message, the latency of the subscriber that had it last [ns].
fn last_of<'a>(all: impl Iterator<Item = &'a Series>) -> Vec<u64> {
    let mut last = Vec::new();
    for series in all {
        last.resize(last.len().max(series.latency.len()), 0);
        for (last, latency) in last.iter_mut().zip(&series.latency) {
            *last = (*last).max(*latency);
        }
    }
    last
}

/// The hop without waking up [ns].
fn transfer(series: &Series) -> Vec<u64> {
    let slept = series.wake_up.iter().copied().chain(std::iter::repeat(0));
    series.latency.iter().zip(slept).map(|(latency, slept)| latency.saturating_sub(slept)).collect()
}

fn row(name: &str, unit: &str, case: &Case, transport: Option<Transport>, summary: Summary) -> Row {
    let wake = if case.poll { "poll" } else { "event" };
    let mut params = BTreeMap::from([
        ("payload_bytes".to_owned(), json!(case.payload_bytes())),
        ("wake".to_owned(), json!(wake)),
        ("subscribers".to_owned(), json!(case.subscribers)),
        ("load".to_owned(), json!(if case.loaded { "busy" } else { "idle" })),
    ]);
    if case.written_before > 0 {
        params.insert("written_before_bytes".into(), json!(case.written_before));
    }
    if let Some(transport) = transport {
        params.insert("transport".into(), Value::from(transport.name()));
    }
    Row {
        name: name.into(),
        params,
        unit: unit.into(),
        summary,
        provenance: Provenance::Measured,
        extra: BTreeMap::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_of_several_subscribers_counts_for_each_message() {
        let series = |latency: &[u64]| Series { latency: latency.to_vec(), wake_up: Vec::new() };
        let all = [series(&[5, 1, 9]), series(&[2, 7, 8])];
        assert_eq!(last_of(all.iter()), [5, 7, 9]);
        assert_eq!(together(all.iter()).latency, [5, 1, 9, 2, 7, 8]);
    }
}
