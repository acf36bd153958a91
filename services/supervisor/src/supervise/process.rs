//! What a child does to itself before its work: die with the supervisor, stay on its cores.

use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::{Result, anyhow, bail};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use rustix::thread::{CpuSet, sched_setaffinity};

/// Lets this process be asked to end when its parent dies, by whatever cause.
///
/// # Errors
/// When the parent is dead already.
pub fn die_with_parent(parent: i32) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM))?;
    // The parent may have died before the line above.
    if getppid().map(Pid::as_raw_nonzero).map(i32::from) != Some(parent) {
        bail!("the supervisor (process {parent}) is gone");
    }
    Ok(())
}

/// Keeps this process on the given cores, as far as the machine has them. No cores means all.
///
/// # Errors
/// When the system refuses.
pub fn pin_to(cores: &[usize]) -> Result<()> {
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    let mut set = CpuSet::new();
    let mut any = false;
    for &core in cores.iter().filter(|core| **core < CpuSet::MAX_CPU) {
        // On a machine with fewer cores the others share what is there.
        if core < available {
            set.set(core);
            any = true;
        } else {
            tracing::warn!(core, available, "this machine has no such core");
        }
    }
    if any {
        sched_setaffinity(None, &set)?;
    }
    Ok(())
}

/// Becomes the program `command` after [`die_with_parent`]: how foreign programs are started.
///
/// # Errors
/// When the program cannot be executed.
pub fn exec_child(parent: i32, command: &[String]) -> Result<()> {
    die_with_parent(parent)?;
    let Some((program, arguments)) = command.split_first() else { bail!("no program is named") };
    // Only comes back when it failed.
    let error = Command::new(program).args(arguments).exec();
    Err(anyhow!("{program}: {error}"))
}
