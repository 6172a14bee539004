//! Rendering a dataset unit by unit; a unit is a frame pair of a scene or a clip of a subject.
//!
//! A `Plan` describes the dataset. `make` claims the folder, finds the missing units of a shard, and renders them with
//! workers, each on a run of consecutive units. Files get their final names when they are complete, so an interrupted run is
//! continued by the next, and the result has the same bytes.

mod folder;
mod hashes;
mod layout;
mod plan;
mod rewrite;
mod timing;

use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use srflow_core::Shard;
use srflow_files::{SHA256SUMS, remove_partial};

use crate::RenderError;

pub(crate) use folder::{claim_as, first_difference, remove};
pub(crate) use hashes::write_hashes;
pub(crate) use layout::{Layout, leading_number, names_in};
use plan::MAX_WORKERS;
pub use plan::{Event, Request};
pub(crate) use plan::{Plan, Run, Work};
pub(crate) use rewrite::until_kept;
use rewrite::was_removed;
pub(crate) use timing::Clock;
pub use timing::{Stage, StageTime};

/// The result of one run.
#[derive(Debug, Clone)]
pub struct Made {
    /// Units of the shard.
    pub units: u64,
    /// Units rendered by this run.
    pub made: u64,
    /// Bytes written by this run.
    pub bytes: u64,
    pub seconds: f64,
    /// The workers' time by stage.
    pub stages: Vec<StageTime>,
    /// Whether the run was stopped before the shard was complete.
    pub stopped: bool,
}

/// Renders the missing units of a shard, with the threads of the current rayon pool. If the dataset is then complete, including all
/// other shards, `finish` writes the files of the whole, and its result is returned.
pub(crate) fn make<P: Plan, T>(
    plan: &P,
    request: Request,
    finish: impl FnOnce(&Path) -> Result<T, RenderError>,
) -> Result<(Made, Option<T>), RenderError> {
    let Request { dir, shard, force, on_event, .. } = request;
    folder::claim(dir, plan, force)?;
    let groups = plan.layout().groups();
    let part = units_of_shard(&groups, shard);
    folder::tidy(dir, plan, &part)?;
    let missing = missing(dir, plan, &part);
    let (units, lacking) = (count(&part), count(&missing));
    on_event(Event::Started { units, whole: units - lacking });

    let start = Instant::now();
    let runs = cut(missing, run_length(lacking, P::LONGEST_RUN));
    let work = Work::new(plan, &request, &runs, (units - lacking, units));
    work.make()?;
    let made = work.made();
    let report = Made {
        units,
        made,
        bytes: work.bytes(),
        seconds: start.elapsed().as_secs_f64(),
        stages: work.clock.spent(),
        stopped: made < lacking,
    };
    if report.stopped || !is_complete(dir, plan.layout(), &groups, &part) {
        return Ok((report, None));
    }
    let finished = complete(dir, plan.layout(), made > 0, request.on_event, finish)?;
    Ok((report, Some(finished)))
}

/// Writes the files of a whole dataset: those of `finish`, and the hashes of all, unless nothing has `changed` and they are there.
pub(crate) fn complete<L: Layout, T>(
    dir: &Path,
    layout: &L,
    changed: bool,
    on_event: &(dyn Fn(Event) + Sync),
    finish: impl FnOnce(&Path) -> Result<T, RenderError>,
) -> Result<T, RenderError> {
    let finished = finish(dir)?;
    if changed || !dir.join(SHA256SUMS).exists() {
        match write_hashes(dir, layout, &|units| on_event(Event::Hashed { units })) {
            // Another process has ended the same work, and removed what this one had begun.
            Err(RenderError::File(error)) if was_removed(&error) && dir.join(SHA256SUMS).exists() => {}
            written => written?,
        }
    }
    remove_partial(dir, |name, _| name.starts_with(SHA256SUMS))?;
    Ok(finished)
}

fn count(runs: &[Run]) -> u64 {
    runs.iter().map(|run| run.units.len() as u64).sum()
}

/// The longest runs that still give every worker several, so that all finish at about the same time.
fn run_length(units: u64, longest: u32) -> u32 {
    let workers = rayon::current_num_threads().min(MAX_WORKERS) as u64;
    (units / (4 * workers)).clamp(1, u64::from(longest)) as u32
}

/// The units of each group that belong to a shard: all units in order, cut into equal parts.
fn units_of_shard(groups: &[u32], shard: Shard) -> Vec<Run> {
    let total: u64 = groups.iter().copied().map(u64::from).sum();
    let Range { start: from, end: to } = shard.range(total);
    let mut before = 0;
    let mut runs = Vec::new();
    for (group, &units) in (0..).zip(groups) {
        let after = before + u64::from(units);
        let within = |place: u64| (place.clamp(before, after) - before) as u32;
        let units = within(from)..within(to);
        if !units.is_empty() {
            runs.push(Run { group, units });
        }
        before = after;
    }
    runs
}

/// The missing units of `runs`, as runs.
fn missing<P: Plan>(dir: &Path, plan: &P, runs: &[Run]) -> Vec<Run> {
    let mut missing: Vec<Run> = Vec::new();
    for run in runs {
        for unit in run.units.clone().filter(|&unit| !plan.layout().is_whole(dir, run.group, unit)) {
            match missing.last_mut() {
                Some(last) if last.group == run.group && last.units.end == unit => last.units.end = unit + 1,
                _ => missing.push(Run { group: run.group, units: unit..unit + 1 }),
            }
        }
    }
    missing
}

/// Whether all units of all parts exist. Those after `part` are asked for first: where parts are made in order, or in folders of their own,
/// one of the first is missing, so that the time of a thousand parts does not grow with the square of the dataset.
fn is_complete<L: Layout>(dir: &Path, layout: &L, groups: &[u32], part: &[Run]) -> bool {
    let end = part.last().map_or((0, 0), |run| (run.group, run.units.end));
    let all = || (0..).zip(groups).flat_map(|(group, &units)| (0..units).map(move |unit| (group, unit)));
    let mut from_end = all().filter(|unit| *unit >= end).chain(all().filter(|unit| *unit < end));
    from_end.all(|(group, unit)| layout.is_whole(dir, group, unit))
}

/// Splits runs into pieces of at most `length` units.
fn cut(runs: Vec<Run>, length: u32) -> Vec<Run> {
    let pieces = |run: Run| {
        let starts = run.units.clone().step_by(length.max(1) as usize);
        starts.map(move |start| Run {
            group: run.group,
            units: start..start.saturating_add(length).min(run.units.end),
        })
    };
    runs.into_iter().flat_map(pieces).collect()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn units(runs: &[Run]) -> Vec<(u32, u32)> {
        runs.iter().flat_map(|run| run.units.clone().map(|unit| (run.group, unit))).collect()
    }

    #[test]
    fn shards_are_equal_and_cover_everything() {
        let groups = [7, 8, 7, 0, 7, 8];
        let whole = units(&units_of_shard(&groups, Shard::WHOLE));
        assert_eq!(whole.len() as u32, groups.iter().sum::<u32>());
        for of in [1, 2, 3, 8, 37, 50] {
            let parts = (1..=of).map(|number| units(&units_of_shard(&groups, Shard { number, of })));
            let parts: Vec<Vec<(u32, u32)>> = parts.collect();
            assert_eq!(parts.concat(), whole);
            let sizes = || parts.iter().map(Vec::len);
            assert!(sizes().max().unwrap() - sizes().min().unwrap() <= 1);
        }
    }

    /// A dataset of one group that counts how often it is asked for a unit.
    struct Asked {
        units: u32,
        whole: Range<u32>,
        times: std::sync::atomic::AtomicU32,
    }

    impl Layout for Asked {
        const MANIFEST: &'static str = "asked.json";
        const UNITS: &'static str = "units";

        fn groups(&self) -> Vec<u32> {
            vec![self.units]
        }

        fn files(&self, _dir: &Path, _group: u32, _unit: u32) -> Vec<PathBuf> {
            Vec::new()
        }

        fn is_whole(&self, _dir: &Path, _group: u32, unit: u32) -> bool {
            self.times.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            self.whole.contains(&unit)
        }

        fn begun_in(&self, _dir: &Path) -> Vec<(u32, u32)> {
            Vec::new()
        }

        fn name(&self, _group: u32, unit: u32) -> String {
            unit.to_string()
        }

        fn others(&self) -> Vec<PathBuf> {
            Vec::new()
        }
    }

    #[test]
    fn a_part_does_not_look_for_all_units_of_the_others() {
        let asked = |whole: Range<u32>, part: Range<u32>| {
            let dataset = Asked { units: 1_000_000, whole, times: Default::default() };
            let part = [Run { group: 0, units: part }];
            let complete = is_complete(Path::new("d"), &dataset, &dataset.groups(), &part);
            (complete, dataset.times.into_inner())
        };
        // In folders of their own, and in order in a shared one.
        for part in [0..1000, 500_000..501_000, 999_000..1_000_000] {
            assert_eq!(asked(part.clone(), part.clone()), (false, 1));
        }
        assert_eq!(asked(0..501_000, 500_000..501_000), (false, 1));
        assert_eq!(asked(0..1_000_000, 999_000..1_000_000), (true, 1_000_000));
        assert_eq!(asked(1..1_000_000, 999_000..1_000_000), (false, 1));
    }

    #[test]
    fn runs_are_cut_without_loss() {
        let runs = vec![Run { group: 0, units: 3..11 }, Run { group: 2, units: 0..1 }];
        let short = cut(runs.clone(), 3);
        assert_eq!(units(&short), units(&runs));
        assert_eq!(short.iter().map(|run| run.units.len()).collect::<Vec<_>>(), [3, 3, 2, 1]);
    }
}
