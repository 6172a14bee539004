//! The description of the machine, and its memory.

use sysinfo::{ProcessRefreshKind, ProcessesToUpdate};

/// Processor, threads in use and operating system.
pub fn describe() -> String {
    let threads = rayon::current_num_threads();
    let plural = if threads == 1 { "" } else { "s" };
    let processor = processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    format!("{threads} thread{plural} of {processor}, {}", std::env::consts::OS)
}

/// The threads that Slurm gives each task; fewer than the cores that a task can see where these are not bound to it. `None` outside of Slurm,
/// and where no more is allowed than control groups do, which the pool of threads keeps to by itself.
pub fn threads_of_job() -> Option<u16> {
    let given: u16 = std::env::var("SLURM_CPUS_PER_TASK").ok()?.parse().ok()?;
    let seen = std::thread::available_parallelism().ok()?.get();
    (given > 0 && usize::from(given) < seen).then_some(given)
}

/// Peak memory of this process in bytes, on Linux; `None` elsewhere.
pub fn peak_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let kilobytes = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix(" kB")?;
    Some(kilobytes.parse::<u64>().ok()? * 1024)
}

/// Available memory in bytes without swapping, within the limits of the process's control groups. `None` where the system
/// does not report it.
pub fn free_memory() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let available = Some(system.available_memory()).filter(|bytes| *bytes > 0)?;
    let process = sysinfo::get_current_pid().ok().and_then(|pid| {
        let (own, nothing) = (ProcessesToUpdate::Some(&[pid]), ProcessRefreshKind::nothing());
        system.refresh_processes_specifics(own, false, nothing);
        system.process(pid)?.cgroup_limits()
    });
    // The page cache counts against the group's limit, but can be reclaimed.
    let within = process.map(|limits| limits.total_memory.saturating_sub(limits.rss));
    Some(within.map_or(available, |within| within.min(available)))
}

/// The processor's name on Linux; `None` elsewhere.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let name = text.lines().find_map(|line| line.strip_prefix("model name"))?;
    Some(name.trim_start_matches([' ', '\t', ':']).to_owned())
}
