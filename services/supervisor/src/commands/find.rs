//! Which graph to look at.

use std::time::Duration;

use anyhow::Result;
use mirador_ipc_schema::{Domain, JoinError, Participant, Peer};

use crate::UsageError;

/// Begins the name under which `top` joins a domain.
pub(super) const WATCHER: &str = "top-";
/// Begins the name under which `replan` joins a domain.
pub(super) const ASKER: &str = "replan-";
/// Names of processes that join a domain only to look or ask.
const WATCHERS: [&str; 3] = [WATCHER, ASKER, "doctor-"];
/// How often a list of processes that failed is asked for again.
const LOOKS: usize = 3;

/// What the search came to.
#[derive(Debug)]
pub(super) enum Found {
    /// The graph of this domain.
    Graph(Domain),
    /// No graph; a sentence for the user.
    Nothing(String),
}

/// The running graph: of the domain `wanted`, else the only one of this user.
///
/// # Errors
/// [`UsageError`] when the name is not valid or several graphs run; anything that keeps a domain from being read.
pub(super) fn running(wanted: Option<&str>) -> Result<Found> {
    let mut candidates = Domain::existing();
    if let Some(name) = wanted {
        let domain = Domain::new(name).map_err(|e| UsageError(e.to_string()))?;
        // Only a domain with files can have processes, and looking into another would make its folder.
        candidates.retain(|d| *d == domain);
    }
    let mut live = Vec::new();
    for domain in candidates {
        if !peers_of_graph(&domain)?.is_empty() {
            live.push(domain);
        }
    }
    Ok(choose(live, wanted)?)
}

/// One of the running graphs.
fn choose(mut live: Vec<Domain>, wanted: Option<&str>) -> Result<Found, UsageError> {
    if live.len() > 1 {
        let names: Vec<&str> = live.iter().map(Domain::name).collect();
        return Err(UsageError(format!(
            "{} graphs are running: {}; choose one with --domain NAME",
            live.len(),
            names.join(", ")
        )));
    }
    Ok(match (live.pop(), wanted) {
        (Some(domain), _) => Found::Graph(domain),
        (None, Some(name)) => Found::Nothing(format!(
            "no graph is running in domain '{name}'; start one with: mirador replay PATH --domain {name}"
        )),
        (None, None) => Found::Nothing("no graph of this user is running; start one with: mirador replay PATH".into()),
    })
}

/// The living processes of a graph, without those that only look.
///
/// # Errors
/// When the domain cannot be read.
pub(super) fn peers_of_graph(domain: &Domain) -> Result<Vec<Peer>, JoinError> {
    let mut listed = Participant::peers(domain);
    for _ in 0..LOOKS {
        if listed.is_ok() {
            break;
        }
        // A process that comes or goes at this moment can spoil the list.
        std::thread::sleep(Duration::from_millis(20));
        listed = Participant::peers(domain);
    }
    let mut peers = listed?;
    peers.retain(|peer| peer.alive && !WATCHERS.iter().any(|prefix| peer.name.starts_with(prefix)));
    Ok(peers)
}

/// Removes the empty shell of a domain in which nobody is, dead or alive: the last file, which iceoryx2 leaves behind,
/// and the folder that looking for processes makes again.
pub(super) fn tidy(domain: &Domain) {
    let empty = Participant::peers(domain).is_ok_and(|peers| peers.is_empty());
    if empty && let Err(error) = domain.remove_all() {
        tracing::debug!(%error, domain = domain.name(), "the files of an ended graph are left");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn domains(names: &[&str]) -> Vec<Domain> {
        names.iter().map(|name| Domain::new(name).unwrap()).collect()
    }

    #[test]
    fn the_only_graph_is_taken() {
        assert!(matches!(choose(domains(&["a"]), None), Ok(Found::Graph(d)) if d.name() == "a"));
    }

    #[test]
    fn several_graphs_are_listed() {
        let error = choose(domains(&["a", "b"]), None).unwrap_err().to_string();
        assert!(error.contains("a, b") && error.contains("--domain"), "{error}");
    }

    #[test]
    fn no_graph_is_said_clearly() {
        let Ok(Found::Nothing(text)) = choose(Vec::new(), Some("x")) else { panic!("there is none") };
        assert!(text.contains("'x'"), "{text}");
        assert!(matches!(choose(Vec::new(), None), Ok(Found::Nothing(_))));
    }
}
