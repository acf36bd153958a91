//! Another people's method in a process of its own: a Python that speaks JSON lines. See `peers/protocol.py`.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_core::scan::Point;
use serde::Deserialize;
use serde_json::{Value, json};

/// Why there is no answer of a peer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PeerError {
    /// The Python cannot be started.
    #[error("it cannot be started: {0}")]
    Start(String),
    /// It says that its library is not there.
    #[error("it is not installed: {0}")]
    Absent(String),
    /// It ended before its answer.
    #[error("it ended with {0}")]
    Ended(String),
    /// It says nothing; it was killed.
    #[error("it gave no answer within {0} s and was killed")]
    Hung(u64),
    /// Its answer is not the one asked for; it was killed.
    #[error("its answer cannot be understood: {0}")]
    Garbage(String),
    /// It refused this request; it goes on with others.
    #[error("it says: {0}")]
    Refused(String),
}

impl PeerError {
    /// Whether nothing more is to be had from the process.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        !matches!(self, Self::Refused(_))
    }
}

/// What a peer found for a pair.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct PairAnswer {
    pub ms: f64,
    #[serde(default)]
    pub parts: BTreeMap<String, f64>,
    #[serde(deserialize_with = "pose")]
    pub pose: Pose,
    pub iterations: Option<u64>,
}

/// What a peer found for a sequence.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct SequenceAnswer {
    pub ms: Vec<f64>,
    #[serde(default)]
    pub parts: BTreeMap<String, f64>,
    #[serde(deserialize_with = "poses")]
    pub poses: Vec<Pose>,
}

/// What a peer found for a pose graph.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct GraphAnswer {
    pub ms: f64,
    #[serde(default)]
    pub parts: BTreeMap<String, f64>,
    #[serde(deserialize_with = "poses")]
    pub poses: Vec<Pose>,
    pub iterations: Option<u64>,
}

fn pose<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
    let rows = <[f64; 16]>::deserialize(deserializer)?;
    rigid(&rows)
}

fn poses<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<Pose>, D::Error> {
    Vec::<[f64; 16]>::deserialize(deserializer)?.iter().map(rigid).collect()
}

fn rigid<E: serde::de::Error>(rows: &[f64; 16]) -> Result<Pose, E> {
    pose_from_rows(rows).ok_or_else(|| E::custom("the pose is not a rigid motion"))
}

/// A running peer; killed when dropped, and once it hangs or talks nonsense.
#[derive(Debug)]
pub struct PeerProcess {
    child: Child,
    /// To the thread that writes: a peer that does not read must not block us.
    requests: Option<Sender<Vec<u8>>>,
    lines: Receiver<String>,
    patience: Duration,
    loaded: Option<String>,
    /// Its name.
    pub name: String,
    /// The version it says it has.
    pub version: String,
}

impl PeerProcess {
    /// Starts `python` on a program text and waits until it is ready. Every later answer must come within `patience`.
    ///
    /// # Errors
    /// Any [`PeerError`] but `Refused`.
    pub fn start(python: &Path, program: &str, patience: Duration) -> Result<Self, PeerError> {
        let mut child = Command::new(python)
            .args(["-c", program])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|e| PeerError::Start(format!("{}: {e}", python.display())))?;
        let (requests, queue) = mpsc::channel::<Vec<u8>>();
        let (sender, lines) = mpsc::channel();
        if let (Some(mut input), Some(output)) = (child.stdin.take(), child.stdout.take()) {
            // Both end with the process: the first by a broken pipe or when the requests end, the second by end of file.
            std::thread::spawn(move || queue.iter().all(|bytes| input.write_all(&bytes).is_ok()));
            std::thread::spawn(move || {
                let lines = BufReader::new(output).split(b'\n').map_while(Result::ok);
                lines.map(|line| String::from_utf8_lossy(&line).into_owned()).all(|line| sender.send(line).is_ok())
            });
        }
        let (name, version) = (String::new(), String::new());
        let mut peer = Self { child, requests: Some(requests), lines, patience, loaded: None, name, version };
        let hello = peer.answer()?;
        if let Some(why) = hello.get("absent") {
            return Err(PeerError::Absent(why.as_str().unwrap_or_default().to_owned()));
        }
        let text = |key: &str| hello.get(key).and_then(Value::as_str).map(str::to_owned);
        let (Some(name), Some(version)) = (text("ready"), text("version")) else {
            return Err(peer.kill(PeerError::Garbage(shortened(&hello.to_string()))));
        };
        (peer.name, peer.version) = (name, version);
        Ok(peer)
    }

    /// Gives it the clouds of a data set, unless it has them.
    ///
    /// # Errors
    /// Any [`PeerError`].
    pub fn load(&mut self, data: &str, clouds: &[&[Point]]) -> Result<(), PeerError> {
        if self.loaded.as_deref() == Some(data) {
            return Ok(());
        }
        self.loaded = None;
        let counts: Vec<usize> = clouds.iter().map(|cloud| cloud.len()).collect();
        let mut bytes = json!({"load": {"data": data, "counts": counts}}).to_string().into_bytes();
        bytes.push(b'\n');
        for point in clouds.iter().copied().flatten() {
            bytes.extend([point.x, point.y, point.z].into_iter().flat_map(f32::to_le_bytes));
        }
        self.send(bytes);
        let answer = self.answer()?;
        if answer.get("loaded").and_then(Value::as_str) != Some(data) {
            return Err(self.kill(PeerError::Garbage(shortened(&answer.to_string()))));
        }
        self.loaded = Some(data.to_owned());
        Ok(())
    }

    /// Asks one question and waits for the answer.
    ///
    /// # Errors
    /// Any [`PeerError`].
    pub fn ask<A: serde::de::DeserializeOwned>(&mut self, request: &str, arguments: &Value) -> Result<A, PeerError> {
        let mut bytes = json!({ request: arguments }).to_string().into_bytes();
        bytes.push(b'\n');
        self.send(bytes);
        let answer = self.answer()?;
        A::deserialize(&answer).map_err(|e| self.kill(PeerError::Garbage(e.to_string())))
    }

    fn send(&self, bytes: Vec<u8>) {
        // It fails when the peer is gone, and then the missing answer says with what it ended.
        let _ = self.requests.as_ref().map(|requests| requests.send(bytes));
    }

    /// The next line, which must be an object.
    fn answer(&mut self) -> Result<Value, PeerError> {
        let line = match self.lines.recv_timeout(self.patience) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => return Err(self.kill(PeerError::Hung(self.patience.as_secs()))),
            Err(RecvTimeoutError::Disconnected) => {
                // Its standard output is closed; a process that lives on without it is of no use.
                let status = self.exit_status();
                return Err(PeerError::Ended(status));
            }
        };
        match serde_json::from_str::<Value>(&line) {
            Ok(answer) if answer.is_object() => match answer.get("error") {
                Some(why) => Err(PeerError::Refused(shortened(why.as_str().unwrap_or_default()))),
                None => Ok(answer),
            },
            _ => Err(self.kill(PeerError::Garbage(shortened(&line)))),
        }
    }

    /// How it ended, waiting a moment for it.
    fn exit_status(&mut self) -> String {
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(1) {
            match self.child.try_wait() {
                Ok(Some(status)) => return status.to_string(),
                Ok(None) => std::thread::sleep(Duration::from_millis(5)),
                Err(error) => return error.to_string(),
            }
        }
        self.end();
        "a closed standard output".into()
    }

    fn kill(&mut self, error: PeerError) -> PeerError {
        self.end();
        error
    }

    fn end(&mut self) {
        self.requests = None;
        // Both fail only when it has ended and been waited for.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        self.end();
    }
}

/// What a message quotes of a text that may be long.
fn shortened(text: &str) -> String {
    let line: String = text.chars().take(200).collect();
    if line.len() < text.len() { format!("{line}...") } else { line }
}

#[cfg(test)]
#[path = "peer_process_tests.rs"]
mod tests;
