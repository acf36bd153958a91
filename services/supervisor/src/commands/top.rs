//! `mirador top`: what the processes of a running graph do, live.
//!
//! A viewer must never hold up what it views: results wait for slow readers. So one thread does nothing but take in
//! messages, and the other writes to the terminal, which may block for as long as it likes.

mod listen;
mod state;
mod table;
mod view;

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use mirador_ipc_schema::{Domain, StopSignal, clock};

use self::listen::Listening;
use self::view::Snapshot;
use super::find::{self, Found};
use crate::cli::Common;
use crate::{EXIT_DONE, EXIT_FAILED};

/// How often the table is drawn.
const REDRAW: Duration = Duration::from_secs(1);
/// How long `--once` waits for every service to be heard, and for rates over a second.
const HEAR_ALL: Duration = Duration::from_millis(1500);
/// The shortest time over which `--once` gives rates.
const RATE_TIME: Duration = Duration::from_millis(1000);
/// How soon a wish to stop is noticed.
const LOOK: Duration = Duration::from_millis(50);

/// Shows the graph of `--domain`, or the only one that runs, until it ends or the user stops. `once` prints a single
/// table; `json` prints an object a line instead of a table. The exit code is 1 when no graph runs.
///
/// # Errors
/// When the domain is not valid, several graphs run, the domain cannot be joined, or its health topic cannot be read.
pub fn top(common: &Common, once: bool, json: bool) -> Result<u8> {
    let domain = match find::running(common.domain.as_deref())? {
        Found::Graph(domain) => domain,
        Found::Nothing(message) => {
            eprintln!("{message}");
            return Ok(EXIT_FAILED);
        }
    };
    let stop = StopSignal::from_terminal().context("the signal handlers cannot be installed")?;
    // A viewer that is suspended takes no messages and would hold up the graph: Ctrl-Z ends it, too.
    let suspended = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(signal_hook::consts::SIGTSTP, Arc::clone(&suspended))
        .context("the signal handlers cannot be installed")?;
    let wishes = Wishes { stop: stop.clone(), suspended };
    let listening = Listening::start(domain.clone(), stop)?;
    let output = Output { json, terminal: io::stdout().is_terminal() && !json && !once };
    let shown = if once {
        show_once(&domain, &listening, &wishes, &output)
    } else {
        show_live(&domain, &listening, &wishes, &output)
    };
    if wishes.suspended.load(Ordering::Relaxed) {
        eprintln!("ended: a suspended viewer would hold up the graph");
    }
    let heard = listening.end();
    find::tidy(&domain);
    let code = shown?;
    heard?;
    Ok(code)
}

/// What the user may wish while the table is shown.
struct Wishes {
    stop: StopSignal,
    suspended: Arc<AtomicBool>,
}

impl Wishes {
    fn end(&self) -> bool {
        self.stop.is_set() || self.suspended.load(Ordering::Relaxed)
    }

    /// Waits, but not longer than until the user wishes to end or the listener has ended.
    fn pause(&self, time: Duration, listening: &Listening) {
        let begin = Instant::now();
        while begin.elapsed() < time && !self.end() && !listening.has_ended() {
            std::thread::sleep(LOOK);
        }
    }
}

fn show_once(domain: &Domain, listening: &Listening, wishes: &Wishes, output: &Output) -> Result<u8> {
    let begin = Instant::now();
    let mut peers = find::peers_of_graph(domain)?;
    while begin.elapsed() < HEAR_ALL && !wishes.end() && !listening.has_ended() {
        if begin.elapsed() >= RATE_TIME && listening.state(|state| state.has_heard(&peers)) {
            break;
        }
        std::thread::sleep(LOOK);
    }
    // Someone may have come or gone meanwhile.
    peers = find::peers_of_graph(domain)?;
    let snapshot = listening.state(|state| state.snapshot(clock::monotonic_ns(), domain.name(), &peers));
    output.write(&snapshot)?;
    Ok(if snapshot.services.is_empty() { EXIT_FAILED } else { EXIT_DONE })
}

fn show_live(domain: &Domain, listening: &Listening, wishes: &Wishes, output: &Output) -> Result<u8> {
    // The first table has something to show.
    wishes.pause(Duration::from_millis(300), listening);
    while !wishes.end() && !listening.has_ended() {
        let peers = find::peers_of_graph(domain)?;
        if peers.is_empty() {
            eprintln!("the graph in domain '{}' has ended", domain.name());
            break;
        }
        let snapshot = listening.state(|state| state.snapshot(clock::monotonic_ns(), domain.name(), &peers));
        if !output.write(&snapshot)? {
            break;
        }
        wishes.pause(REDRAW, listening);
    }
    Ok(EXIT_DONE)
}

/// How a snapshot is written.
struct Output {
    json: bool,
    /// The table is drawn over the last one.
    terminal: bool,
}

impl Output {
    /// Writes a snapshot; false when nobody reads any more.
    fn write(&self, snapshot: &Snapshot) -> Result<bool> {
        let text = if self.json {
            format!("{}\n", serde_json::to_string(snapshot)?)
        } else if self.terminal {
            over_the_last(&table::render(snapshot))
        } else {
            format!("{}\n", table::render(snapshot))
        };
        let mut out = io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
            Err(error) => Err(error).context("standard output"),
        }
    }
}

/// The codes that draw a text over the last one without flicker: home, every line cleared to its end, the rest cleared
/// below; lines that are too long are cut by the terminal.
fn over_the_last(text: &str) -> String {
    let lines: String = text.lines().map(|line| format!("{line}\x1b[K\r\n")).collect();
    format!("\x1b[?7l\x1b[H{lines}\x1b[J\x1b[?7h")
}

#[cfg(test)]
mod tests {
    use mirador_ipc_schema::Participant;

    use super::*;

    #[test]
    fn a_table_is_drawn_over_the_last_line_by_line() {
        let drawn = over_the_last("a\nb\n");
        assert_eq!(drawn, "\x1b[?7l\x1b[Ha\x1b[K\r\nb\x1b[K\r\n\x1b[J\x1b[?7h");
    }

    #[test]
    fn a_service_that_reports_is_heard() {
        let name = format!("top-hear-{}", std::process::id());
        let domain = Domain::new(&name).unwrap();
        let sizes = mirador_ipc_schema::Sizes { scan_points: 1 };
        let wake = mirador_ipc_schema::Wake::Event;
        let service = Participant::join(domain.clone(), "planning", 0, sizes, wake, StopSignal::default()).unwrap();
        let mut health = mirador_ipc_schema::service::HealthReporter::open(&service, "planning").unwrap();
        health.running(&service);
        let listening = Listening::start(domain.clone(), StopSignal::default()).unwrap();
        let peers = find::peers_of_graph(&domain).unwrap();
        let begin = Instant::now();
        while !listening.state(|state| state.has_heard(&peers)) {
            assert!(begin.elapsed() < Duration::from_secs(20), "nothing was heard");
            std::thread::sleep(LOOK);
            health.heartbeat(&service);
        }
        let snapshot = listening.state(|state| state.snapshot(clock::monotonic_ns(), &name, &peers));
        assert_eq!(snapshot.services.len(), 1);
        assert_eq!((snapshot.services[0].pid, snapshot.notes.len()), (std::process::id(), 0));
        listening.end().unwrap();
        drop((health, service));
        find::tidy(&domain);
        assert!(domain.segments().is_empty());
    }

    #[test]
    fn a_domain_without_a_graph_is_told_and_left_alone() {
        let name = format!("top-none-{}", std::process::id());
        assert!(matches!(find::running(Some(&name)).unwrap(), Found::Nothing(_)));
        assert!(!Domain::new(&name).unwrap().root().exists(), "looking must leave nothing behind");
    }

    #[test]
    fn peers_that_only_watch_are_no_graph() {
        let name = format!("top-watch-{}", std::process::id());
        let domain = Domain::new(&name).unwrap();
        let sizes = mirador_ipc_schema::Sizes { scan_points: 1 };
        let wake = mirador_ipc_schema::Wake::Event;
        let watcher = Participant::join(domain.clone(), "top-1", 0, sizes, wake, StopSignal::default()).unwrap();
        assert!(find::peers_of_graph(&domain).unwrap().is_empty());
        let service = Participant::join(domain.clone(), "planning", 0, sizes, wake, StopSignal::default()).unwrap();
        assert_eq!(find::peers_of_graph(&domain).unwrap()[0].name, "planning");
        assert!(matches!(find::running(Some(&name)).unwrap(), Found::Graph(found) if found == domain));
        drop((service, watcher));
        find::tidy(&domain);
        assert!(domain.segments().is_empty() && !domain.root().exists());
    }
}
