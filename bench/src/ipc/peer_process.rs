//! Starting the second process, and ending it in any case.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::BenchError;
use super::case::Case;
use super::peer::Report;

/// How long the second process may take from its start to its open ports, and from the last message to its report.
const PATIENCE: Duration = Duration::from_secs(30);
/// How often a wait looks at whether it should end.
const LOOK: Duration = Duration::from_millis(50);

/// The second process; killed when dropped.
pub(super) struct PeerProcess {
    child: Child,
    command: String,
    lines: Receiver<Report>,
}

impl PeerProcess {
    /// Starts `command` with the case as its last argument. Its own process group keeps the terminal's Ctrl-C from it:
    /// the first process ends it.
    pub fn start(command: &[String], case: &Case) -> Result<Self, BenchError> {
        let text = command.join(" ");
        let failed = |reason: String| BenchError::Peer { command: text.clone(), reason };
        let (program, arguments) = command.split_first().ok_or_else(|| failed("no program is named".into()))?;
        let case = serde_json::to_string(case).map_err(|e| failed(e.to_string()))?;
        let mut child = Command::new(program)
            .args(arguments)
            .arg(case)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()
            .map_err(|e| failed(e.to_string()))?;
        let (sender, lines) = mpsc::channel();
        if let Some(out) = child.stdout.take() {
            // It ends with the last line: when the second process is gone.
            std::thread::spawn(move || {
                for report in BufReader::new(out).lines().map_while(Result::ok).filter_map(|line| Report::parse(&line))
                {
                    if sender.send(report).is_err() {
                        break;
                    }
                }
            });
        }
        Ok(Self { child, command: text, lines })
    }

    /// The pipe to its standard input.
    pub fn take_stdin(&mut self) -> Result<ChildStdin, BenchError> {
        self.child.stdin.take().ok_or_else(|| self.failed("it has no standard input".into()))
    }

    /// Waits for what it says next, unless `stop` says that the run should end.
    pub fn next_report(&mut self, stop: impl Fn() -> bool) -> Result<Report, BenchError> {
        let begin = Instant::now();
        loop {
            match self.lines.recv_timeout(LOOK) {
                Ok(report) => return Ok(report),
                Err(RecvTimeoutError::Disconnected) => {
                    let reason = match self.child.wait() {
                        Ok(status) => format!("it ended with {status}"),
                        Err(error) => error.to_string(),
                    };
                    return Err(self.failed(reason));
                }
                Err(RecvTimeoutError::Timeout) if stop() => return Err(BenchError::Interrupted),
                Err(RecvTimeoutError::Timeout) if begin.elapsed() > PATIENCE => {
                    return Err(self.failed(format!("it says nothing for {} s", PATIENCE.as_secs())));
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// What it ended with, if it has ended.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Waits until it has ended well, its ports closed.
    pub fn finish(mut self) -> Result<(), BenchError> {
        let begin = Instant::now();
        loop {
            match self.ended() {
                Some(status) if status.success() => return Ok(()),
                Some(status) => return Err(self.failed(format!("it ended with {status}"))),
                None if begin.elapsed() > PATIENCE => return Err(self.failed("it does not end".into())),
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
    }

    /// An error about it.
    pub fn failed(&self, reason: String) -> BenchError {
        BenchError::Peer { command: self.command.clone(), reason }
    }
}

impl Drop for PeerProcess {
    fn drop(&mut self) {
        // Both fail only when it has ended and been waited for.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
