//! Logging in, asking for sweeps, and reading them, over any stream of bytes.

use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use super::{Framer, ScanData, TelegramError, wrapped};

/// How long an answer may take.
const ANSWER: Duration = Duration::from_secs(2);
/// How long a device may need until it measures: its mirror has to come up to speed.
const WARM_UP: Duration = Duration::from_secs(30);
/// Between two looks at its state.
const LOOK: Duration = Duration::from_millis(200);
/// `STlms`: ready for measurement.
const READY: &str = "7";
/// The user "authorised client" and the hash of its factory password.
const LOG_IN: &str = "sMN SetAccessMode 03 F4724744";
/// Ranges and strengths of 16 bits, no encoder, no position, no name, no comment, no time, every sweep.
const CONTENT: &str = "sWN LMDscandatacfg 01 00 1 1 0 00 00 0 0 0 0 +1";

/// Why a device cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SessionError {
    /// The connection failed.
    #[error("the connection failed: {0}")]
    Io(#[from] std::io::Error),
    /// The device closed the connection.
    #[error("the device closed the connection")]
    Closed,
    /// Nothing came in time.
    #[error("the device did not answer '{0}'")]
    Silent(String),
    /// The device refused what it was asked for.
    #[error("the device refused '{asked}': it answered '{answer}'")]
    Refused {
        /// What it was asked.
        asked: String,
        /// What it answered.
        answer: String,
    },
    /// The device does not come to measure.
    #[error("the device does not measure: its state is {0} where 7 (ready for measurement) is needed")]
    WrongState(String),
    /// The user wished to end.
    #[error("stopped")]
    Stopped,
}

/// What came from the device.
#[derive(Debug)]
pub(crate) enum Event {
    /// A sweep.
    Sweep(ScanData),
    /// Something that is not a sweep, or a damaged one.
    Bad(TelegramError),
}

/// A conversation with a device. Reads of `stream` must end after a while without data.
pub(crate) struct Session<S> {
    stream: S,
    framer: Framer,
    buffer: Vec<u8>,
}

impl<S: Read + Write> Session<S> {
    /// Logs in, sets what a sweep is to hold, starts the measurement and waits until the device measures, then asks for
    /// every sweep. `is_stopped` ends any wait.
    ///
    /// # Errors
    /// See [`SessionError`].
    pub fn open(stream: S, is_stopped: &dyn Fn() -> bool) -> Result<Self, SessionError> {
        let mut session = Self { stream, framer: Framer::default(), buffer: vec![0; 1 << 16] };
        session.ask(LOG_IN, "sAN SetAccessMode 1", is_stopped)?;
        session.ask(CONTENT, "sWA LMDscandatacfg", is_stopped)?;
        session.ask("sMN LMCstartmeas", "sAN LMCstartmeas 0", is_stopped)?;
        session.ask("sMN Run", "sAN Run 1", is_stopped)?;
        session.wait_until_ready(is_stopped)?;
        session.ask("sEN LMDscandata 1", "sEA LMDscandata 1", is_stopped)?;
        Ok(session)
    }

    /// Bytes that belonged to no telegram.
    pub fn garbage(&self) -> u64 {
        self.framer.garbage()
    }

    /// What has come, sweeps and what is not one; empty when a read ended without data.
    ///
    /// # Errors
    /// When the connection is at an end.
    pub fn receive(&mut self, events: &mut Vec<Event>) -> Result<(), SessionError> {
        self.read_once()?;
        while let Some(telegram) = self.framer.next() {
            events.push(match ScanData::parse(telegram) {
                Ok(sweep) => Event::Sweep(sweep),
                Err(error) => Event::Bad(error),
            });
        }
        Ok(())
    }

    fn wait_until_ready(&mut self, is_stopped: &dyn Fn() -> bool) -> Result<(), SessionError> {
        let begin = Instant::now();
        loop {
            let answer = self.ask("sRN STlms", "sRA STlms", is_stopped)?;
            let state = answer.split_ascii_whitespace().nth(2).unwrap_or("missing").trim_start_matches('0').to_owned();
            if state == READY {
                return Ok(());
            }
            if begin.elapsed() > WARM_UP {
                return Err(SessionError::WrongState(state));
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Sends a command and waits for its answer, which must begin with `expected`. Sweeps that still run in from an
    /// earlier conversation are passed over.
    fn ask(&mut self, asked: &str, expected: &str, is_stopped: &dyn Fn() -> bool) -> Result<String, SessionError> {
        self.stream.write_all(&wrapped(asked))?;
        let name = asked.split(' ').nth(1).unwrap_or(asked);
        let begin = Instant::now();
        while begin.elapsed() < ANSWER {
            if is_stopped() {
                return Err(SessionError::Stopped);
            }
            while let Some(telegram) = self.framer.next() {
                let answer = String::from_utf8_lossy(telegram).into_owned();
                let is_refusal = answer.starts_with("sFA");
                if answer.starts_with(expected) {
                    return Ok(answer);
                }
                let is_about_it = !answer.starts_with("sSN") && answer.split(' ').nth(1) == Some(name);
                if is_refusal || is_about_it {
                    return Err(SessionError::Refused { asked: asked.to_owned(), answer });
                }
            }
            self.read_once()?;
        }
        Err(SessionError::Silent(asked.to_owned()))
    }

    fn read_once(&mut self) -> Result<(), SessionError> {
        match self.stream.read(&mut self.buffer) {
            Ok(0) => Err(SessionError::Closed),
            Ok(n) => {
                self.framer.push(self.buffer.get(..n).unwrap_or_default());
                Ok(())
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                Ok(())
            }
            Err(e) => Err(e.into()),
        }
    }
}
