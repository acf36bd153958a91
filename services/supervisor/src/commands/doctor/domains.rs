//! The domains of this user: who runs, and what the dead have left.

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use anyhow::Result;
use mirador_ipc_schema::{CleanupReport, Domain, Participant, Peer, Sizes, StopSignal, Wake};

use super::{Finding, megabytes};
use crate::UsageError;

/// Checks the folder of the domains, then each domain, or only the one of this name. With `fix`, what dead processes
/// have left is removed; what is used by anyone alive, or belongs to another user, is never touched.
///
/// # Errors
/// [`UsageError`] when the name is not valid.
pub(super) fn check(only: Option<&str>, fix: bool) -> Result<Vec<Finding>> {
    let domains = match only {
        Some(name) => {
            let domain = Domain::new(name).map_err(|e| UsageError(e.to_string()))?;
            Domain::existing().into_iter().filter(|d| *d == domain).collect()
        }
        None => Domain::existing(),
    };
    // Any name will do: the folder is the same for all.
    let parent = Domain::new("any").map_err(|e| UsageError(e.to_string()))?.parent();
    let uid = rustix::process::getuid().as_raw();
    let mut findings = vec![check_parent(&parent, uid)];
    for domain in &domains {
        findings.extend(check_domain(domain, uid, fix));
    }
    if domains.is_empty() {
        let which = only.map_or_else(|| "none of this user".to_owned(), |name| format!("'{name}' has no files"));
        findings.push(Finding::ok("domains", which));
    }
    Ok(findings)
}

/// The folder around the domains must be this user's alone.
fn check_parent(parent: &Path, uid: u32) -> Finding {
    let subject = "domain folder";
    let path = parent.display();
    let meta = match fs::symlink_metadata(parent) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Finding::ok(subject, format!("{path} does not exist yet; the first graph makes it"));
        }
        Err(error) => return Finding::problem(subject, format!("{path}: {error}; make it accessible to user {uid}")),
        Ok(meta) => meta,
    };
    let mode = meta.permissions().mode() & 0o777;
    if !meta.is_dir() || meta.uid() != uid {
        let text = format!("{path} is not a folder of user {uid} (owner {}); have its owner remove it", meta.uid());
        return Finding::problem(subject, text);
    }
    if mode & 0o077 != 0 {
        let text = format!("{path} is open to other users (mode {mode:o}); run: chmod 700 {path}");
        return Finding::problem(subject, text);
    }
    Finding::ok(subject, format!("{path} is private (mode {mode:o})"))
}

/// Files and bytes of a domain, and whether all are this user's.
struct Leftovers {
    files: usize,
    bytes: u64,
    /// The owner of a file that is not this user's.
    foreign: Option<u32>,
}

fn leftovers(domain: &Domain, uid: u32) -> Leftovers {
    let mut left = Leftovers { files: 0, bytes: 0, foreign: None };
    for meta in domain.segments().iter().filter_map(|path| fs::symlink_metadata(path).ok()) {
        left.files += 1;
        left.bytes += meta.blocks() * 512;
        if meta.uid() != uid {
            left.foreign = Some(meta.uid());
        }
    }
    left
}

fn check_domain(domain: &Domain, uid: u32, fix: bool) -> Option<Finding> {
    let subject = format!("domain {}", domain.name());
    let left = leftovers(domain, uid);
    if let Some(owner) = left.foreign {
        let text = format!("has files of user {owner} in /dev/shm, which are not touched; use another --domain");
        return Some(Finding::problem(subject, text));
    }
    let peers = match Participant::peers(domain) {
        Ok(mut peers) => {
            peers.sort_by_key(|peer| peer.pid);
            peers
        }
        Err(error) => return Some(Finding::problem(subject, format!("cannot be looked at: {error}"))),
    };
    let (alive, dead): (Vec<Peer>, Vec<Peer>) = peers.into_iter().partition(|peer| peer.alive);
    if !alive.is_empty() {
        return Some(check_live(domain, subject, &alive, dead.len(), left.bytes, fix));
    }
    // An empty folder is what every graph leaves behind; nobody needs to hear of it.
    let empty = left.files == 0 && fs::read_dir(domain.root()).is_ok_and(|mut entries| entries.next().is_none());
    if empty && !fix {
        return None;
    }
    Some(check_stale(domain, subject, &left, fix))
}

fn check_live(domain: &Domain, subject: String, alive: &[Peer], dead: usize, bytes: u64, fix: bool) -> Finding {
    let names: Vec<String> = alive.iter().map(|p| format!("{} ({})", p.name, p.pid)).collect();
    let text = format!("alive, {}: {}", megabytes(bytes), names.join(", "));
    if dead == 0 {
        return Finding::ok(subject, text);
    }
    if !fix {
        let text = format!("{text}; and {dead} dead, whose places are taken until --fix or the supervisor frees them");
        return Finding::warning(subject, text);
    }
    match clean_dead_peers(domain) {
        Ok(0) => Finding::ok(subject, format!("{text}; freed what {dead} dead had left")),
        Ok(rest) => {
            let text = format!("{text}; {rest} dead cannot be freed: end the graph, then --fix again");
            Finding::warning(subject, text)
        }
        Err(error) => Finding::warning(subject, format!("{text}; {dead} dead cannot be freed: {error}")),
    }
}

/// Frees what the dead of a living domain have left; returns how many remain.
fn clean_dead_peers(domain: &Domain) -> Result<usize> {
    let name = format!("doctor-{}", std::process::id());
    let sizes = Sizes { scan_points: 1 };
    let participant = Participant::join(domain.clone(), &name, 0, sizes, Wake::Event, StopSignal::default())?;
    participant.clean_dead_peers();
    Ok(Participant::peers(domain)?.iter().filter(|peer| !peer.alive).count())
}

fn check_stale(domain: &Domain, subject: String, left: &Leftovers, fix: bool) -> Finding {
    if !fix {
        let text = format!(
            "nobody is alive, but {} with {} are left; remove with: mirador doctor --fix",
            files(left.files),
            megabytes(left.bytes)
        );
        return Finding::warning(subject, text);
    }
    match remove_if_dead(domain) {
        Ok(Some(removed)) => {
            let text = format!("nobody was alive; removed {}, {}", files(removed.segments), megabytes(removed.bytes));
            Finding::ok(subject, text)
        }
        Ok(None) => Finding::ok(subject, "a graph has just started in it; nothing removed"),
        Err(error) => Finding::problem(subject, format!("nobody is alive, but: {error:#}; remove it by hand")),
    }
}

fn files(count: usize) -> String {
    if count == 1 { "1 file".into() } else { format!("{count} files") }
}

/// Looks once more before it removes: a graph may have started since.
fn remove_if_dead(domain: &Domain) -> Result<Option<CleanupReport>> {
    if Participant::peers(domain)?.iter().any(|peer| peer.alive) {
        return Ok(None);
    }
    Ok(Some(domain.remove_all()?))
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;
    use std::os::unix::fs::symlink;

    fn uid() -> u32 {
        rustix::process::getuid().as_raw()
    }

    /// A domain of this test alone, with a file in `/dev/shm` as a killed graph leaves it.
    fn domain_with_a_file(name: &str) -> Domain {
        let domain = Domain::new(&format!("doc-{name}-{}", std::process::id())).unwrap();
        domain.config().unwrap();
        fs::write(format!("/dev/shm/{}left.data", domain.prefix()), vec![1; 8192]).unwrap();
        domain
    }

    #[test]
    fn what_the_dead_have_left_is_reported_and_removed_only_when_asked() {
        let domain = domain_with_a_file("dead");
        let found = check_domain(&domain, uid(), false).unwrap();
        assert_eq!(found.level, Level::Warning);
        assert!(found.text.contains("1 file ") && found.text.contains("--fix"), "{}", found.text);
        assert_eq!(domain.segments().len(), 1);

        let fixed = check_domain(&domain, uid(), true).unwrap();
        assert_eq!(fixed.level, Level::Ok);
        assert!(fixed.text.contains("removed 1 file,"), "{}", fixed.text);
        assert!(domain.segments().is_empty() && !domain.root().exists());
    }

    #[test]
    fn a_domain_with_someone_alive_is_not_touched() {
        let domain = domain_with_a_file("live");
        let sizes = Sizes { scan_points: 1 };
        let participant =
            Participant::join(domain.clone(), "alignment", 0, sizes, Wake::Event, StopSignal::default()).unwrap();
        let before = domain.segments();
        let found = check_domain(&domain, uid(), true).unwrap();
        assert_eq!(found.level, Level::Ok);
        assert!(found.text.contains(&format!("alignment ({})", std::process::id())), "{}", found.text);
        assert_eq!(domain.segments(), before);
        assert_eq!(remove_if_dead(&domain).unwrap(), None);
        drop(participant);
        domain.remove_all().unwrap();
    }

    #[test]
    fn files_of_another_user_are_not_touched() {
        let domain = domain_with_a_file("other");
        // Seen by any other user, the files are foreign.
        let found = check_domain(&domain, uid() + 1, true).unwrap();
        assert_eq!(found.level, Level::Problem);
        assert_eq!(domain.segments().len(), 1);
        domain.remove_all().unwrap();
    }

    #[test]
    fn a_folder_that_others_can_enter_is_a_problem() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("parent");
        assert_eq!(check_parent(&path, uid()).level, Level::Ok, "it is made later");
        fs::create_dir(&path).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        let open = check_parent(&path, uid());
        assert_eq!(open.level, Level::Problem);
        assert!(open.text.contains("chmod 700"), "{}", open.text);
        fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
        assert_eq!(check_parent(&path, uid()).level, Level::Ok);
        assert_eq!(check_parent(&path, uid() + 1).level, Level::Problem);
        let link = folder.path().join("link");
        symlink(&path, &link).unwrap();
        assert_eq!(check_parent(&link, uid()).level, Level::Problem, "a link could lead anywhere");
    }

    #[test]
    fn a_name_that_is_no_domain_is_wrong_usage() {
        assert!(check(Some("../x"), true).unwrap_err().is::<UsageError>());
    }
}
