//! What a time was measured on, and how much memory there is.

use sysinfo::{ProcessRefreshKind, ProcessesToUpdate};

/// Processor, threads in use and operating system, in a few words.
pub fn describe() -> String {
    let threads = rayon::current_num_threads();
    let plural = if threads == 1 { "" } else { "s" };
    let processor = processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    format!("{threads} thread{plural} of {processor}, {}", std::env::consts::OS)
}

/// The most memory that this process has had, in bytes, as Linux tells it; `None` elsewhere.
pub fn peak_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let kilobytes = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix(" kB")?;
    Some(kilobytes.parse::<u64>().ok()? * 1024)
}

/// Memory in bytes that can be had without swapping: what the system calls available, and not more than what the limits of
/// the control groups this process is in leave. `None` where the system does not say.
pub fn free_memory() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let available = Some(system.available_memory()).filter(|bytes| *bytes > 0)?;
    let process = sysinfo::get_current_pid().ok().and_then(|pid| {
        let (own, nothing) = (ProcessesToUpdate::Some(&[pid]), ProcessRefreshKind::nothing());
        system.refresh_processes_specifics(own, false, nothing);
        system.process(pid)?.cgroup_limits()
    });
    // Files that the group has read count against its limit, and make way.
    let within = process.map(|limits| limits.total_memory.saturating_sub(limits.rss));
    Some(within.map_or(available, |within| within.min(available)))
}

/// The processor's name as Linux tells it; `None` elsewhere.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let name = text.lines().find_map(|line| line.strip_prefix("model name"))?;
    Some(name.trim_start_matches([' ', '\t', ':']).to_owned())
}
