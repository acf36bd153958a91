//! Carries out the runs that are not there yet, and writes what they come to.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};

use mirador_core::view_planning::StrategyRegistry;

use super::store::Store;
use super::{Entry, ExperimentError, Results, RunRecord, Settings, entries, markdown, page, picture};
use crate::BenchReport;
use crate::exploration::{ExplorationError, World, WorldQuality};

/// How an experiment ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Every run is there.
    Finished,
    /// Stopped on the way; what is finished is kept.
    Interrupted,
}

/// A piece of work: a run, or the ceiling of a world.
enum Task<'a> {
    Run { entry: &'a Entry, seed: u64 },
    Ceiling { world: &'a str },
}

impl Task<'_> {
    fn file(&self) -> String {
        match self {
            Self::Run { entry, seed } => format!("runs/{}-{seed}.json", entry.id()),
            Self::Ceiling { world } => format!("runs/{world}-ceiling.json"),
        }
    }
}

/// Runs an experiment in `folder`, `jobs` runs side by side, and writes experiment.json, .md and .html from all runs that
/// are there. `is_stopped` is asked after every scan; `say` is told of every run.
///
/// # Errors
/// See [`ExperimentError`]; finished runs are kept whatever happens.
pub fn run(
    settings: &Settings,
    folder: &Path,
    jobs: usize,
    registry: &StrategyRegistry,
    is_stopped: &(dyn Fn() -> bool + Sync),
    say: &mut dyn FnMut(&str),
) -> Result<(BenchReport, Ending), ExperimentError> {
    settings.validate(registry)?;
    let store = Store::open(folder, settings)?;
    let entries = entries(&settings.worlds, &settings.experiments, registry)?;
    let runner = Runner { settings, store: &store, registry, jobs: jobs.max(1), is_stopped };
    for world in &settings.worlds {
        runner.explore(world, &entries, say)?;
    }
    let results = Results::read(settings, &entries, &store)?;
    let report = results.report();
    let pretty = serde_json::to_vec_pretty(&report);
    let pretty = pretty.map_err(|e| ExperimentError::Draw { what: "experiment.json".into(), reason: e.to_string() })?;
    store.write_bytes("experiment.json", &pretty)?;
    store.write_bytes("experiment.md", markdown::render(&results).as_bytes())?;
    store.write_bytes("experiment.html", page::render(&results, &store)?.as_bytes())?;
    let ending = if results.is_complete() { Ending::Finished } else { Ending::Interrupted };
    Ok((report, ending))
}

struct Runner<'a> {
    settings: &'a Settings,
    store: &'a Store,
    registry: &'a StrategyRegistry,
    jobs: usize,
    is_stopped: &'a (dyn Fn() -> bool + Sync),
}

impl Runner<'_> {
    /// All that is not there yet of one world.
    fn explore(&self, world: &str, entries: &[Entry], say: &mut dyn FnMut(&str)) -> Result<(), ExperimentError> {
        let mut tasks = vec![Task::Ceiling { world }];
        for seed in self.settings.all_seeds() {
            let here = entries.iter().filter(|entry| entry.world == world);
            tasks.extend(here.map(|entry| Task::Run { entry, seed }));
        }
        let all = tasks.len();
        tasks.retain(|task| self.store.bytes(&task.file()).is_none());
        if tasks.len() < all {
            say(&format!("{world}: {} of {all} are there already", all - tasks.len()));
        }
        if tasks.is_empty() || (self.is_stopped)() {
            return Ok(());
        }
        let scene = World::named(world).map_err(|source| ExperimentError::Exploration { run: world.into(), source })?;
        let (queue, has_failed) = (Mutex::new(tasks.into_iter()), AtomicBool::new(false));
        let (tell, told) = mpsc::channel();
        let work = |tell: mpsc::Sender<String>| -> Result<(), ExperimentError> {
            while !(self.is_stopped)() && !has_failed.load(Ordering::Relaxed) {
                let Some(task) = queue.lock().unwrap_or_else(PoisonError::into_inner).next() else { break };
                let done = self.carry_out(&scene, &task).inspect_err(|_| has_failed.store(true, Ordering::Relaxed))?;
                // Nobody listens any more only when the caller is gone.
                let _ = done.map(|line| tell.send(line));
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.jobs)
                .map(|_| {
                    let tell = tell.clone();
                    scope.spawn(|| work(tell))
                })
                .collect();
            drop(tell);
            told.iter().for_each(|line| say(&line));
            for worker in workers {
                match worker.join() {
                    Ok(result) => result?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            Ok(())
        })
    }

    /// Does a piece of work, keeps it, and says what came out; `None` when it was stopped on the way.
    fn carry_out(&self, world: &World, task: &Task<'_>) -> Result<Option<String>, ExperimentError> {
        let threads = if self.jobs == 1 { 2 } else { 1 };
        let failure = |source: ExplorationError| ExperimentError::Exploration { run: task.file(), source };
        let (entry, seed) = match *task {
            Task::Run { entry, seed } => (entry, seed),
            Task::Ceiling { .. } => {
                let ceiling: WorldQuality =
                    world.ceiling(&self.settings.scanner(), threads, self.is_stopped).map_err(failure)?;
                if (self.is_stopped)() {
                    return Ok(None);
                }
                self.store.write(&task.file(), &ceiling)?;
                let WorldQuality { scans, quality, .. } = ceiling;
                return Ok(Some(format!("{}: {scans} scans from everywhere give quality {quality:.3}", world.name)));
            }
        };
        let run = self.settings.exploration(entry, seed, threads);
        let outcome = run.run(world, self.registry, self.is_stopped).map_err(failure)?;
        if (self.is_stopped)() {
            return Ok(None);
        }
        let mut frame = None;
        if seed == self.settings.first_seed
            && let Some((at, png)) = picture::draw(&outcome.map)?
        {
            self.store.write_bytes(&format!("runs/{}-{seed}.png", entry.id()), &png)?;
            frame = Some(at);
        }
        let record = RunRecord::new(entry, seed, &outcome, frame);
        self.store.write(&task.file(), &record)?;
        let last = outcome.last();
        let given_up = match record.given_up.len() {
            0 => String::new(),
            targets => format!(", {targets} targets given up"),
        };
        Ok(Some(format!(
            "{} {} seed {seed}: {} scans, {:.0} m, quality {:.3}, coverage {:.3}, {}{given_up}",
            entry.world,
            entry.label(),
            outcome.scans(),
            last.metres,
            last.quality,
            last.coverage,
            record.stop_word(),
        )))
    }
}
