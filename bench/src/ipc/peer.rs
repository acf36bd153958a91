//! The second process: the subscriber.

use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;

use mirador_ipc_schema::{Domain, Participant, Sizes, StopSignal, Wake};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};

use super::bare::BareNode;
use super::case::Case;
use super::receive::{Receive, ReceiveBytes, ReceiveIceoryx2, ReceiveMirador, resident_buffer};
use super::{BenchError, Transport, pin};

/// What the second process says, one line of standard output each.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Report {
    /// Its ports are open.
    Ready,
    /// Latencies of each transport of the pair, in the order of the rounds, without the warm-up.
    Latencies([Series; 2]),
}

/// What the subscriber saw of one transport [ns].
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) struct Series {
    /// From the stamp to holding the message.
    pub latency: Vec<u64>,
    /// Of that, until the sleeping subscriber was awake; empty where it does not sleep.
    pub wake_up: Vec<u64>,
}

/// Begins the lines that are meant for the first process, so that a program may print other things too.
const MARK: &str = "mirador-bench-peer ";

impl Report {
    /// The report as a line.
    fn line(&self) -> Result<String, BenchError> {
        let json = serde_json::to_string(self).map_err(BenchError::io("write a report"))?;
        Ok(format!("{MARK}{json}"))
    }

    /// The report in a line, if it has one.
    pub fn parse(line: &str) -> Option<Self> {
        serde_json::from_str(line.strip_prefix(MARK)?).ok()
    }
}

/// Where the Unix socket of a domain is.
pub(super) fn socket_path(domain: &Domain) -> PathBuf {
    domain.root().join("bench.sock")
}

/// The second process of the message benchmark; `arguments` are those behind the command that leads here. It ends with
/// the process that started it.
///
/// # Errors
/// See [`BenchError`]; the caller prints it and ends with a failure.
pub fn peer_main(arguments: impl IntoIterator<Item = String>) -> Result<(), BenchError> {
    set_parent_process_death_signal(Some(Signal::KILL)).map_err(BenchError::io("ask to end with the first process"))?;
    let bad = |reason: String| BenchError::BadPeerArguments { reason };
    let argument = arguments.into_iter().next().ok_or_else(|| bad("no case is named".into()))?;
    let case: Case = serde_json::from_str(&argument).map_err(|e| bad(e.to_string()))?;
    if let Some(core) = case.subscriber_core {
        pin::pin(core);
    }
    let mut receivers = [open(&case, case.pair[0])?, open(&case, case.pair[1])?];
    say(&Report::Ready)?;
    let mut latencies = [Series::default(), Series::default()];
    for series in &mut latencies {
        let rounds = usize::try_from(case.rounds).unwrap_or(0);
        series.latency.reserve_exact(rounds);
        series.wake_up.reserve_exact(rounds);
    }
    for (round, place) in case.turns() {
        let heard = receivers[place].receive(round)?;
        if round >= case.warm_up {
            latencies[place].latency.push(heard.latency);
            latencies[place].wake_up.extend(heard.wake_up);
        }
    }
    say(&Report::Latencies(latencies))
}

fn say(report: &Report) -> Result<(), BenchError> {
    let mut out = io::stdout().lock();
    writeln!(out, "{}", report.line()?).and_then(|()| out.flush()).map_err(BenchError::io("write to standard output"))
}

fn open(case: &Case, transport: Transport) -> Result<Box<dyn Receive>, BenchError> {
    let domain = Domain::new(&case.domain)?;
    let (points, wake) = (case.points, case.wake());
    Ok(match transport {
        Transport::Mirador => Box::new(open_mirador(domain, points, wake)?),
        Transport::Iceoryx2 => {
            let (subscriber, listener) = BareNode::join(&domain, "bench-subscriber")?.subscriber(wake)?;
            Box::new(ReceiveIceoryx2 { subscriber, listener, points })
        }
        Transport::UnixSocket => {
            let stream =
                UnixStream::connect(socket_path(&domain)).map_err(BenchError::io("connect the Unix socket"))?;
            Box::new(ReceiveBytes { transport, stream, buffer: resident_buffer(case.payload_bytes()) })
        }
        Transport::Pipe => {
            // Standard input is the pipe; a handle of its own leaves out the buffer of the standard library.
            let pipe = io::stdin().as_fd().try_clone_to_owned().map_err(BenchError::io("take the pipe"))?;
            Box::new(ReceiveBytes {
                transport,
                stream: File::from(pipe),
                buffer: resident_buffer(case.payload_bytes()),
            })
        }
    })
}

fn open_mirador(domain: Domain, points: usize, wake: Wake) -> Result<ReceiveMirador, BenchError> {
    let sizes = Sizes { scan_points: points };
    let participant = Participant::join(domain, "bench-subscriber", 0, sizes, wake, StopSignal::default())?;
    let subscriber = participant.subscriber()?;
    Ok(ReceiveMirador { participant, wake, subscriber, points })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_found_among_other_lines() {
        let report = Report::Latencies([Series { latency: vec![1, 2], wake_up: vec![1] }, Series::default()]);
        assert_eq!(Report::parse(&report.line().unwrap()), Some(report));
        assert_eq!(Report::parse("running 1 test"), None);
        assert_eq!(Report::parse("mirador-bench-peer {\"other\":1}"), None);
    }

    #[test]
    fn a_peer_started_by_hand_says_who_should() {
        let error = peer_main(["hello".to_owned()]).unwrap_err();
        assert!(error.to_string().contains("mirador bench ipc"), "{error}");
    }
}
