//! The supervisor of the process graph and the command line `mirador`.
//!
//! [`main_with`] is the whole program: a binary of your own that calls it with one registration method more is
//! `mirador` with that method.

pub mod cli;
mod commands;
pub mod explain;
pub mod graph;
mod output_dir;
pub mod outputs;
mod progress;
pub mod supervise;

use std::process::ExitCode;

pub use mirador_core::registration::Registry;

/// The run did what it was asked.
pub const EXIT_DONE: u8 = 0;
/// Something failed on the way.
pub const EXIT_FAILED: u8 = 1;
/// The command line, a path or the configuration is wrong.
pub const EXIT_USAGE: u8 = 2;
/// Stopped by the user, cleanly.
pub const EXIT_INTERRUPTED: u8 = 130;

/// An error in what the user gave: the command line, a path, a configuration. It ends the program with
/// [`EXIT_USAGE`]; every other error with [`EXIT_FAILED`].
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Runs the command line with these registration methods.
#[must_use]
pub fn main_with(registry: Registry) -> ExitCode {
    let cli = match cli::Cli::read(std::env::args_os()) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are errors to clap, too, but of exit code 0. A closed pipe is nobody's problem.
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(EXIT_USAGE));
        }
    };
    cli::init_logging(&cli.common);
    match commands::dispatch(cli, registry) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {}", one_line(&error));
            let usage = error.chain().any(|cause| cause.is::<UsageError>());
            ExitCode::from(if usage { EXIT_USAGE } else { EXIT_FAILED })
        }
    }
}

/// The error and its causes on one line. A cause whose text the line already contains is left out.
fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let text = cause.to_string().replace('\n', " ");
        if line.is_empty() {
            line = text;
        } else if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
    }
    line
}
