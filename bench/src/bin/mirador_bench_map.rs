//! The map benchmark by itself: `mirador-bench-map [JSON FILE]` measures with the default options, prints the table and
//! writes the report.

use std::process::ExitCode;

use mirador_bench::map::{MapOptions, run};

fn main() -> ExitCode {
    let measure = || -> Result<(), Box<dyn std::error::Error>> {
        let report = run(&MapOptions::default())?;
        report.print_table(&mut std::io::stdout().lock())?;
        if let Some(file) = std::env::args().nth(1) {
            std::fs::write(file, serde_json::to_string_pretty(&report)? + "\n")?;
        }
        Ok(())
    };
    match measure() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mirador-bench-map: {error}");
            ExitCode::FAILURE
        }
    }
}
