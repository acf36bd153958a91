//! `mirador bench`.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use mirador_bench::ipc::{IpcOptions, run};
use mirador_ipc_schema::StopSignal;

use crate::{EXIT_DONE, UsageError};

/// Latency between two processes.
pub fn ipc(json: Option<&Path>, messages: Option<usize>, pace_ms: Option<f64>) -> Result<u8> {
    let own = std::env::current_exe().context("the path of this program is not known")?;
    let mut options = IpcOptions {
        peer_command: vec![own.to_string_lossy().into_owned(), "bench-peer".into(), "--".into()],
        stop: StopSignal::from_terminal()?,
        ..IpcOptions::default()
    };
    if let Some(messages) = messages {
        for payload in &mut options.payloads {
            payload.messages = messages as u64;
        }
    }
    if let Some(ms) = pace_ms {
        let pace = Duration::try_from_secs_f64(ms / 1e3);
        options.pace =
            pace.map_err(|_| UsageError(format!("--pace-ms {ms}: give a time of 0 or more milliseconds")))?;
    }
    let report = run(&options)?;
    report.print_table(&mut std::io::stdout().lock())?;
    if let Some(path) = json {
        let text = serde_json::to_string_pretty(&report)?;
        std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(EXIT_DONE)
}
