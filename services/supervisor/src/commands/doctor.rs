//! `mirador doctor`: what on this machine would get in the way of a graph, and what to do about it.

mod domains;
mod machine;
mod memory;

use std::io::{self, Write};

use anyhow::Result;

use crate::cli::Common;
use crate::{EXIT_DONE, EXIT_FAILED};

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Level {
    /// As it should be, or only worth knowing.
    Ok,
    /// A graph runs, but slower or with less room than it could.
    Warning,
    /// A graph would not start, or not last.
    Problem,
}

impl Level {
    fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Problem => "problem",
        }
    }
}

/// The result of one check.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Finding {
    level: Level,
    /// What was looked at.
    subject: String,
    /// What was found and, when it is not ok, what to do.
    text: String,
    /// Lines of a table that belongs to it.
    table: Vec<String>,
}

impl Finding {
    fn new(level: Level, subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self { level, subject: subject.into(), text: text.into(), table: Vec::new() }
    }

    fn ok(subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self::new(Level::Ok, subject, text)
    }

    fn warning(subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self::new(Level::Warning, subject, text)
    }

    fn problem(subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self::new(Level::Problem, subject, text)
    }

    fn with_table(mut self, table: Vec<String>) -> Self {
        self.table = table;
        self
    }
}

/// Checks this machine and prints a line a check; with `fix` it removes what dead processes have left. The exit code
/// is 1 while a problem remains.
///
/// # Errors
/// When the name of the domain is not valid or standard output cannot be written.
pub fn doctor(common: &Common, fix: bool) -> Result<u8> {
    // Cleaning comes first, so that the free space is the one a graph will find.
    let domains = domains::check(common.domain.as_deref(), fix)?;
    let mut findings = memory::check(common);
    findings.extend(domains);
    findings.extend(machine::check(&common.cores));
    write_out(&render(&findings))?;
    let problem = findings.iter().any(|f| f.level == Level::Problem);
    Ok(if problem { EXIT_FAILED } else { EXIT_DONE })
}

/// The findings as aligned lines, and a sentence that sums them up.
fn render(findings: &[Finding]) -> String {
    let width = findings.iter().map(|f| f.subject.chars().count()).max().unwrap_or(0);
    let mut out = String::new();
    for finding in findings {
        // What comes from files may hold line breaks; a check is one line.
        let text = finding.text.replace('\n', " ");
        out.push_str(&format!("{:<7}  {:<width$}  {text}\n", finding.level.word(), finding.subject));
        for line in &finding.table {
            out.push_str(&format!("{:7}    {line}\n", ""));
        }
    }
    let count = |level| findings.iter().filter(|f| f.level == level).count();
    let summary = match (count(Level::Problem), count(Level::Warning)) {
        (0, 0) => "nothing is in the way".to_owned(),
        (0, warnings) => format!("nothing is in the way; warnings: {warnings}"),
        (problems, warnings) => format!("problems: {problems}, warnings: {warnings}"),
    };
    out.push_str(&format!("\n{summary}\n"));
    out
}

/// Writes to standard output; a reader that has gone is not an error.
fn write_out(text: &str) -> io::Result<()> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Bytes in words: MB with one decimal below 100 MB, without above.
fn megabytes(bytes: u64) -> String {
    let mb = bytes as f64 / 1e6;
    if mb < 100.0 { format!("{mb:.1} MB") } else { format!("{mb:.0} MB") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finding_is_one_aligned_line_and_the_worst_are_counted() {
        let text = render(&[
            Finding::ok("cores", "2").with_table(vec!["a  1".into()]),
            Finding::warning("governor", "powersave;\nset performance"),
            Finding::problem("open files", "64"),
        ]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "ok       cores       2");
        assert_eq!(lines[1], "           a  1");
        assert_eq!(lines[2], "warning  governor    powersave; set performance");
        assert_eq!(lines[3], "problem  open files  64");
        assert_eq!(lines[5], "problems: 1, warnings: 1");
    }

    #[test]
    fn a_machine_without_findings_against_it_is_told_so() {
        assert!(render(&[Finding::ok("cores", "2")]).ends_with("nothing is in the way\n"));
        assert!(render(&[Finding::warning("cores", "1")]).contains("warnings: 1"));
    }
}
