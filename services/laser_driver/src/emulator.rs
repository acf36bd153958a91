//! A device on loopback that speaks as an LMS1xx does, and misbehaves when asked to.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::cola::{Framer, wrapped};

/// How it behaves.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Manner {
    /// Bytes a write; 0 sends telegrams whole.
    pub piece: usize,
    /// Every so many sweeps one is garbled; 0 never.
    pub garble_every: u32,
    /// Every so many sweeps one is left out; 0 never.
    pub skip_every: u32,
    /// Every so many sweeps one comes twice; 0 never.
    pub repeat_every: u32,
    /// Closes the connection after so many sweeps; 0 never.
    pub hang_up_after: u32,
    /// Says nothing more after so many sweeps; 0 never.
    pub fall_silent_after: u32,
    /// Looks at the state until it measures.
    pub warm_up_looks: u32,
    /// Refuses to log in.
    pub refuses: bool,
}

/// Ranges of every sweep [mm]: three beams, the first without a return.
pub(crate) const RANGES_MM: [u32; 3] = [0, 1500, 20000];

/// A device that runs until it is dropped.
pub(crate) struct Emulator {
    pub address: SocketAddr,
    pub connections: Arc<AtomicU32>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    pub fn start(manner: Manner) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, connections) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU32::new(0)));
        let (seen, count) = (Arc::clone(&stop), Arc::clone(&connections));
        let thread = std::thread::spawn(move || {
            while !seen.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((stream, _)) => {
                        count.fetch_add(1, Ordering::Relaxed);
                        // An error is a client that went away.
                        let _ = Device { manner, stream, framer: Framer::default(), looks: 0, since: Instant::now() }
                            .serve(&seen);
                    }
                    Err(_) => std::thread::sleep(Duration::from_millis(2)),
                }
            }
        });
        Self { address, connections, stop, thread: Some(thread) }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

struct Device {
    manner: Manner,
    stream: TcpStream,
    framer: Framer,
    looks: u32,
    since: Instant,
}

impl Device {
    fn serve(mut self, stop: &AtomicBool) -> std::io::Result<()> {
        self.stream.set_nonblocking(false)?;
        self.stream.set_read_timeout(Some(Duration::from_millis(2)))?;
        let mut buffer = [0; 4096];
        let (mut is_streaming, mut sweeps) = (false, 0_u32);
        while !stop.load(Ordering::Relaxed) {
            match self.stream.read(&mut buffer) {
                Ok(0) => return Ok(()),
                Ok(n) => self.framer.push(&buffer[..n]),
                Err(_) => {}
            }
            while let Some(asked) = self.framer.next().map(|t| String::from_utf8_lossy(t).into_owned()) {
                is_streaming |= asked == "sEN LMDscandata 1";
                let answer = self.answer(&asked);
                self.say(&wrapped(&answer))?;
            }
            let is_silent = self.manner.fall_silent_after > 0 && sweeps >= self.manner.fall_silent_after;
            if !is_streaming || is_silent {
                continue;
            }
            sweeps += 1;
            if self.manner.hang_up_after > 0 && sweeps > self.manner.hang_up_after {
                return Ok(());
            }
            self.sweep(sweeps)?;
        }
        Ok(())
    }

    fn answer(&mut self, asked: &str) -> String {
        match asked.split(' ').nth(1).unwrap_or_default() {
            "SetAccessMode" => format!("sAN SetAccessMode {}", u32::from(!self.manner.refuses)),
            "LMDscandatacfg" => "sWA LMDscandatacfg".into(),
            "LMCstartmeas" => "sAN LMCstartmeas 0".into(),
            "Run" => "sAN Run 1".into(),
            "STlms" => {
                self.looks += 1;
                let state = if self.looks > self.manner.warm_up_looks { 7 } else { 5 };
                format!("sRA STlms {state} 0 8 07:12:12 8 01.05.2006 0 0 0")
            }
            "LMDscandata" => "sEA LMDscandata 1".into(),
            _ => "sFA 1".into(),
        }
    }

    fn sweep(&mut self, number: u32) -> std::io::Result<()> {
        let is_due = |every: u32| every > 0 && number.is_multiple_of(every);
        if is_due(self.manner.skip_every) {
            return Ok(());
        }
        let ranges: Vec<String> = RANGES_MM.iter().map(|mm| format!("{mm:X}")).collect();
        let measured = u32::try_from(self.since.elapsed().as_micros()).unwrap();
        let mut text = format!(
            "sSN LMDscandata 1 1 89A27F 0 0 {number:X} {:X} {measured:X} {:X} 0 0 7 0 0 1388 168 0 1 DIST1 3F800000 00000000 \
             FFF92230 1388 3 {} 1 RSSI1 3F800000 00000000 FFF92230 1388 3 0 FE 10 0 0 0 0 0",
            // The counter wraps within the test.
            (number + 65_500) & 0xffff,
            measured + 500,
            ranges.join(" "),
        );
        if is_due(self.manner.garble_every) {
            text = text.replace("DIST1", "D?ST1\u{7f}").replace("3F8", "zzz");
        }
        let times = if is_due(self.manner.repeat_every) { 2 } else { 1 };
        self.say(&wrapped(&text).repeat(times))
    }

    fn say(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        if self.manner.piece == 0 {
            return self.stream.write_all(bytes);
        }
        bytes.chunks(self.manner.piece).try_for_each(|piece| {
            self.stream.write_all(piece)?;
            self.stream.flush()
        })
    }
}
