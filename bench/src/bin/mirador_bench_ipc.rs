//! The message benchmark by itself: `mirador-bench-ipc [JSON FILE]` measures with the default options, prints the table
//! and writes the report. Users run `mirador bench ipc`.

use std::process::ExitCode;

use mirador_bench::ipc::{BenchError, IpcOptions, peer_main, run};
use mirador_ipc_schema::StopSignal;

/// Leads to the second process.
const PEER: &str = "peer";

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    let result = if arguments.next_if(|first| first == PEER).is_some() {
        peer_main(arguments)
    } else {
        measure(arguments.next().as_deref())
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mirador-bench-ipc: {error}");
            ExitCode::FAILURE
        }
    }
}

fn measure(json: Option<&str>) -> Result<(), BenchError> {
    let io = |what| move |source| BenchError::Io { what, source };
    let program = std::env::current_exe().map_err(io("find this program"))?;
    let options = IpcOptions {
        peer_command: vec![program.to_string_lossy().into_owned(), PEER.into()],
        stop: StopSignal::from_terminal().map_err(io("catch Ctrl-C"))?,
        ..IpcOptions::default()
    };
    let report = run(&options)?;
    report.print_table(&mut std::io::stdout().lock()).map_err(io("print the table"))?;
    if let Some(file) = json {
        let text = serde_json::to_string_pretty(&report).map_err(|e| io("write the report")(e.into()))?;
        std::fs::write(file, text + "\n").map_err(io("write the report"))?;
    }
    Ok(())
}
