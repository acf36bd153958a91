//! Reading and checking a graph file.

use std::path::{Path, PathBuf};

use toml_edit::DocumentMut;

use super::overrides;
use super::tables::{Graph, ServiceEntry};
use crate::Registry;

/// Points of the largest scan that can be asked for: far more than any scanner takes, and far from what overflows.
const MOST_POINTS: usize = 1_000_000_000;

/// Why a graph file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    /// The file cannot be read.
    #[error("{path}: cannot be read ({reason})")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The text is not TOML, a key is unknown, or a value has the wrong type.
    #[error("{file}:{line}: {message}")]
    Invalid {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong and what would be right.
        message: String,
    },
    /// A `--set` is wrong.
    #[error("{0}")]
    Override(String),
    /// A value is outside its range or names something that does not exist.
    #[error("{file}{}: {key}: {message}", line_suffix(*.line))]
    Value {
        /// The file.
        file: String,
        /// The line of the key, when it stands in the file.
        line: Option<usize>,
        /// The key.
        key: String,
        /// What is wrong and what would be right.
        message: String,
    },
}

fn line_suffix(line: Option<usize>) -> String {
    line.map_or_else(String::new, |n| format!(":{n}"))
}

/// Loads a graph file and applies the overrides.
///
/// # Errors
/// See [`GraphError`].
pub fn load(path: &Path, settings: &[String], registry: &Registry) -> Result<Graph, GraphError> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| GraphError::Unreadable { path: path.into(), reason: e.to_string() })?;
    load_text(&text, &path.display().to_string(), settings, registry)
}

/// Loads a graph from its text; `file` names it in errors.
///
/// # Errors
/// See [`GraphError`].
pub fn load_text(text: &str, file: &str, settings: &[String], registry: &Registry) -> Result<Graph, GraphError> {
    // The file alone first, so that its errors carry its own lines.
    let mut graph = parse(text, file)?;
    if !settings.is_empty() {
        let mut document: DocumentMut =
            text.parse().map_err(|e: toml_edit::TomlError| invalid(text, file, e.span(), e.message()))?;
        // One after the other, so that the error names the one that is wrong.
        for setting in settings {
            overrides::apply(&mut document, setting).map_err(GraphError::Override)?;
            graph = toml::from_str(&document.to_string())
                .map_err(|e| GraphError::Override(format!("--set {setting}: {}", one_line(e.message()))))?;
        }
    }
    check(&graph, text, file, registry)?;
    Ok(graph)
}

fn parse(text: &str, file: &str) -> Result<Graph, GraphError> {
    toml::from_str(text).map_err(|e| invalid(text, file, e.span(), e.message()))
}

fn invalid(text: &str, file: &str, span: Option<std::ops::Range<usize>>, message: &str) -> GraphError {
    let begin = span.as_ref().map_or(0, |s| s.start);
    let before = text.get(..begin).unwrap_or("");
    let message = match span.and_then(|s| key_before(before, text.get(s)?)) {
        Some(key) => format!("{key}: {}", one_line(message)),
        None => one_line(message),
    };
    GraphError::Invalid { file: file.into(), line: before.matches('\n').count() + 1, message }
}

/// The key whose value an error points at; none when it points at a key itself.
fn key_before<'a>(before: &'a str, place: &str) -> Option<&'a str> {
    let line = before.rsplit('\n').next()?;
    let key = line.split_once('=')?.0.trim();
    (!place.is_empty() && !key.is_empty()).then_some(key)
}

fn one_line(message: &str) -> String {
    message.replace('\n', ", ")
}

/// What types alone cannot check.
fn check(graph: &Graph, text: &str, file: &str, registry: &Registry) -> Result<(), GraphError> {
    let fail = |key: &str, message: String| {
        Err(GraphError::Value { file: file.into(), line: find_line(text, key), key: key.into(), message })
    };
    if graph.config_version != 1 {
        return fail(
            "config_version",
            format!("{} is not known to this version of mirador; write 1", graph.config_version),
        );
    }
    if graph.graph.max_points > MOST_POINTS {
        let message = format!("{} is outside 0 (as many as the source has) to {MOST_POINTS}", graph.graph.max_points);
        return fail("graph.max_points", message);
    }
    if let Err(error) = mirador_ipc_schema::Domain::new(&graph.graph.domain) {
        return fail("graph.domain", error.to_string());
    }
    let services = graph.services.entries().into_iter().map(|(name, entry)| ("services", name, entry));
    let programs = graph.programs.iter().map(|(name, entry)| ("programs", name.as_str(), entry));
    for (table, name, entry) in services.chain(programs) {
        if let Err((key, message)) = check_entry(entry) {
            return fail(&format!("{table}.{name}.{key}"), message);
        }
    }
    let is_needed = |name: &str| name != "gateway";
    if let Some((name, _)) = graph.services.entries().into_iter().find(|(name, e)| e.optional && is_needed(name)) {
        let message = "a service is not optional: leave its table out where it is not needed".into();
        return fail(&format!("services.{name}.optional"), message);
    }
    let external = &graph.alignment.external.program;
    if graph.alignment.is_external() && !external.is_empty() && !graph.programs.contains_key(external) {
        let message = format!(
            "the external registration is to be answered by the program '{external}', which is missing: write \
             [programs.{external}] with its command, or name another in alignment.external.program (\"\" when it is \
             started by hand)"
        );
        return fail("alignment.registration", message);
    }
    if let Some((name, _)) = graph.programs.iter().find(|(_, e)| e.command.is_empty()) {
        return fail(
            &format!("programs.{name}.command"),
            "names no program; write [\"PROGRAM\", \"ARGUMENT\", ...]".into(),
        );
    }
    if let Err(error) = graph.alignment.check(registry) {
        return fail("alignment.registration", error.to_string());
    }
    let checks: [(&str, Result<(), String>); 10] = [
        ("simulator", graph.simulator.validate().map_err(|e| e.to_string())),
        ("laser_driver", graph.laser_driver.validate().map_err(|e| e.to_string())),
        ("localization", graph.localization.validate().map_err(|e| e.to_string())),
        ("navigation", graph.navigation.validate().map_err(|e| e.to_string())),
        ("acquisition", graph.acquisition.validate().map_err(|e| e.to_string())),
        ("alignment", graph.alignment.validate().map_err(|e| e.to_string())),
        ("analysis", graph.analysis.validate().map_err(|e| e.to_string())),
        ("gateway", graph.gateway.validate()),
        ("recorder", graph.recorder.validate().map_err(|e| e.to_string())),
        ("planning", graph.planning.validate().map_err(|e| e.to_string())),
    ];
    for (table, result) in checks {
        if let Err(message) = result {
            return fail(table, message);
        }
    }
    Ok(())
}

fn check_entry(entry: &ServiceEntry) -> Result<(), (&'static str, String)> {
    if entry.threads == 0 || entry.threads > 256 {
        return Err(("threads", format!("{} is outside 1 to 256", entry.threads)));
    }
    // Services report every 50 ms; nobody is held up for less than a few times that.
    if entry.health_timeout_ms != 0 && !(200..=3_600_000).contains(&entry.health_timeout_ms) {
        let message = format!("{} is neither 0 (never) nor between 200 and 3,600,000", entry.health_timeout_ms);
        return Err(("health_timeout_ms", message));
    }
    Ok(())
}

/// The line on which the last part of a key is set, as far as a search of the text can tell.
fn find_line(text: &str, key: &str) -> Option<usize> {
    let (tables, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut inside = tables.is_empty();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(header) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            if header == key {
                return Some(index + 1);
            }
            inside = header == tables;
        } else if inside && line.split('=').next().is_some_and(|k| k.trim() == last) {
            return Some(index + 1);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        load_text(text, "graph.toml", &[], &Registry::default()).unwrap_err().to_string()
    }

    #[test]
    fn the_standard_graph_is_valid() {
        let graph = load_text(super::super::STANDARD, "standard", &[], &Registry::default()).unwrap();
        assert_eq!(graph.services.entries().len(), 5);
        let graph = load_text(super::super::EXPLORATION, "exploration", &[], &Registry::default()).unwrap();
        assert_eq!(graph.services.entries().len(), 8);
    }

    #[test]
    fn an_unknown_service_is_named_with_its_line_and_the_known_ones() {
        let message = error("config_version = 1\n\n[services.alignmnt]\nthreads = 1\n");
        assert!(message.starts_with("graph.toml:3:") && message.contains("alignmnt"), "{message}");
        assert!(message.contains("`acquisition`") && message.contains("`recorder`"), "{message}");
    }

    #[test]
    fn an_unknown_registration_is_named_with_its_line_and_the_known_ones() {
        let message = error("config_version = 1\n[alignment]\nregistration = \"magic\"\n");
        assert!(message.starts_with("graph.toml:3: alignment.registration:"), "{message}");
        assert!(message.contains("magic") && message.contains("point_to_plane"), "{message}");
    }

    #[test]
    fn an_external_registration_without_a_program_is_told_what_to_write() {
        let message = error("config_version = 1\n[alignment]\nregistration = \"external\"\n");
        assert!(message.starts_with("graph.toml:3: alignment.registration:"), "{message}");
        assert!(message.contains("[programs.registration]"), "{message}");
        let registry = Registry::default();
        let text = "config_version = 1\n[alignment]\nregistration = \"external\"\nexternal.program = \"\"\n";
        assert!(load_text(text, "g", &[], &registry).unwrap().alignment.is_external());
        let message = error(
            "config_version = 1\n[alignment]\nregistration = \"external\"\nexternal.fallback = \"x\"\nexternal.program = \"\"\n",
        );
        assert!(message.contains("`x`") && message.contains("gicp"), "{message}");
    }

    #[test]
    fn a_service_cannot_be_optional_and_a_health_timeout_cannot_be_shorter_than_a_few_reports() {
        let message = error("config_version = 1\n[services.planning]\noptional = true\n");
        assert!(message.starts_with("graph.toml:3: services.planning.optional:"), "{message}");
        let message = error("config_version = 1\n[programs.a]\ncommand = [\"true\"]\nhealth_timeout_ms = 60\n");
        assert!(message.starts_with("graph.toml:4: programs.a.health_timeout_ms: 60"), "{message}");
    }

    #[test]
    fn a_value_of_the_wrong_type_names_its_line() {
        let message = error("config_version = 1\n[services.planning]\nthreads = \"two\"\n");
        assert!(message.starts_with("graph.toml:3: threads: ") && message.contains("two"), "{message}");
    }

    #[test]
    fn slots_for_more_points_than_memory_can_be_counted_for_are_refused() {
        let message = error("config_version = 1\n[graph]\nmax_points = 9223372036854775807\n");
        assert!(message.starts_with("graph.toml:3: graph.max_points: 9223372036854775807"), "{message}");
    }

    #[test]
    fn of_several_overrides_the_wrong_one_is_named() {
        let settings = ["graph.lockstep=true", "graph.wake=shout", "graph.domain=a"].map(str::to_owned);
        let text = "config_version = 1\n";
        let message = load_text(text, "g", &settings, &Registry::default()).unwrap_err().to_string();
        assert!(message.starts_with("--set graph.wake=shout: ") && !message.contains("graph.domain"), "{message}");
        assert!(message.contains("`event`") && message.contains("`poll`"), "{message}");
    }

    #[test]
    fn an_unknown_policy_lists_the_policies() {
        let message = error("config_version = 1\n[services.planning]\nrestart = \"sometimes\"\n");
        assert!(message.contains("on-failure") && message.contains("never"), "{message}");
    }

    #[test]
    fn an_override_wins_over_the_file_and_is_checked_like_it() {
        let registry = Registry::default();
        let text = "config_version = 1\n[graph]\nlockstep = true\n";
        let graph = load_text(text, "g", &["graph.lockstep=false".into()], &registry).unwrap();
        assert!(!graph.graph.lockstep);
        let message = load_text(text, "g", &["graph.lockstop=false".into()], &registry).unwrap_err().to_string();
        assert!(message.contains("--set graph.lockstop=false") && message.contains("lockstep"), "{message}");
    }

    #[test]
    fn the_effective_graph_can_be_saved_and_loaded_again() {
        let registry = Registry::default();
        let graph = load_text(super::super::STANDARD, "standard", &[], &registry).unwrap();
        let text = toml::to_string(&graph).unwrap();
        let again = load_text(&text, "saved", &[], &registry).unwrap();
        assert_eq!(toml::to_string(&again).unwrap(), text);
    }
}
