//! What a time was measured on.

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

/// The processor's name as Linux tells it; `None` elsewhere.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let name = text.lines().find_map(|line| line.strip_prefix("model name"))?;
    Some(name.trim_start_matches([' ', '\t', ':']).to_owned())
}
