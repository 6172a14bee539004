//! Expressions in the motion of a face: bumps that stand out from noise and from what the face does around them.
//!
//! A family of bumps of various lengths is fitted to the motion of each region at every moment, each on a slope, by least squares. What
//! the lids explain is taken out, so that a blink is no motion of the brows. A bump counts by its height in deviations of the
//! region's noise; a short one also by the other bumps within two seconds, so that speech is no row of micro-expressions.

use std::f64::consts::PI;

use rayon::prelude::*;
use serde::Serialize;
use srflow_core::{dense, median};
use srflow_data::micro_expression::intervals::ExpressionKind;

use super::regions::{LIDS, REGIONS, RegionMotion};
use super::signals::Signals;

/// What decides what is spotted. Lengths of motion are shares of the crop's side.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SpottingSettings {
    /// Micro-expressions stand out from noise and surroundings by this factor at least.
    pub micro_score: f64,
    /// Macro-expressions stand out from noise by this factor at least.
    pub macro_score: f64,
}

impl Default for SpottingSettings {
    fn default() -> Self {
        Self { micro_score: 3.2, macro_score: 20.0 }
    }
}

const MICRO_SECONDS: [f64; 2] = [0.2, 0.3];
const MACRO_SECONDS: [f64; 6] = [0.8, 1.1, 1.5, 2.0, 2.6, 3.3];

/// The longest micro-expression, between the frames that people annotate.
const LONGEST_MICRO_SECONDS: f64 = 0.6;
const SHORTEST_SECONDS: f64 = 0.1;

/// Seconds at rest on either side of a bump.
const MICRO_MARGIN_SECONDS: f64 = 0.25;
const MACRO_MARGIN_SECONDS: f64 = 0.6;

/// Part of a long bump in which it rises, and in which it falls.
const RAMP: f64 = 0.3;

/// Least deviation of noise, and least heights of bumps.
const LEAST_NOISE: f64 = 1.7e-4;
const LEAST_MICRO: f64 = 6.7e-4;
const LEAST_MACRO: f64 = 8.4e-3;

/// What moves further in so short a time is a hand before the face, or the head.
const LARGEST_MICRO: f64 = 0.04;

/// How much the surroundings of a short bump count, and which they are: within the first, but not within half the bump and the second.
const SURROUNDINGS: f64 = 2.0;
const SURROUNDING_SECONDS: f64 = 2.0;
const GUARD_SECONDS: f64 = 0.4;

/// A region's short bump is at least this part of the lids'.
const LEAST_OF_LIDS: f64 = 0.3;

/// Macro-expressions are compared with micro-expressions by this factor: where both fit, the shorter one is taken more easily.
const MACRO_WEIGHT: f64 = 0.6;

/// In so many of a macro-expression's frames the face is seen and steady; in a micro-expression's, in all.
const LEAST_USABLE: f64 = 0.75;

/// From the apex to the onset it is so many times as far as to the frame of half the height.
const ONSET_OF_HALF: f64 = 1.85;

/// A spotted expression. Frames count from 0 along the signals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpottedEvent {
    #[serde(rename = "type")]
    pub kind: ExpressionKind,
    pub onset: usize,
    pub apex: usize,
    pub offset: usize,
    /// The region that stands out most.
    pub region: &'static str,
    /// Height of its bump, in pixels.
    pub height_px: f64,
    /// How far it stands out.
    pub score: f64,
    /// Whether the lids move more than the region: perhaps a blink.
    pub with_lids: bool,
}

/// Finds the expressions in signals at so many frames per second, of a crop of this side in pixels.
pub fn spot_events(
    signals: &Signals,
    fps: f64,
    side: usize,
    settings: SpottingSettings,
) -> Vec<SpottedEvent> {
    let side = side as f64;
    let motion = smoothed(&signals.regions);
    let micro = MICRO_SECONDS.map(|seconds| (ExpressionKind::Micro, seconds));
    let macros = MACRO_SECONDS.map(|seconds| (ExpressionKind::Macro, seconds));
    let mut candidates = Vec::new();
    for (kind, seconds) in micro.into_iter().chain(macros) {
        let least = match kind {
            ExpressionKind::Micro => settings.micro_score,
            ExpressionKind::Macro => settings.macro_score,
        };
        let bumps = bumps(&motion, &signals.usable, fps, side, kind, seconds);
        candidates.extend(bumps.into_iter().filter(|bump| bump.score >= least));
    }
    candidates.sort_by(|a, b| b.rank().total_cmp(&a.rank()).then(a.at.cmp(&b.at)));
    let mut kept: Vec<SpottedEvent> = Vec::new();
    for bump in candidates {
        let Some(event) = bump.event(&motion, fps) else { continue };
        let usable = signals.usable[event.onset..=event.offset].iter().filter(|usable| **usable).count();
        let least = match event.kind {
            ExpressionKind::Micro => 1.0,
            ExpressionKind::Macro => LEAST_USABLE,
        };
        if usable as f64 >= least * (event.offset - event.onset + 1) as f64
            && kept.iter().all(|other| event.offset < other.onset || event.onset > other.offset)
        {
            kept.push(event);
        }
    }
    kept.sort_by_key(|event| event.onset);
    kept
}

/// A mean over three frames.
fn smoothed(motion: &[RegionMotion]) -> Vec<RegionMotion> {
    let at = |frame: isize| &motion[frame.clamp(0, motion.len() as isize - 1).cast_unsigned()];
    let mean = |frame: usize| {
        let around = [-1, 0, 1].map(|step| at(frame.cast_signed() + step));
        std::array::from_fn(|region| {
            [0, 1].map(|axis| {
                let [before, now, after] = around.map(|motion| motion[region][axis]);
                (before + 2.0 * now + after) / 4.0
            })
        })
    };
    (0..motion.len()).map(mean).collect()
}

/// A bump at a frame.
struct Bump {
    kind: ExpressionKind,
    seconds: f64,
    at: usize,
    region: usize,
    height: f64,
    lids: f64,
    score: f64,
}

/// Bumps of one length, where they stand out more than a frame before and after.
fn bumps(
    motion: &[RegionMotion],
    usable: &[bool],
    fps: f64,
    side: f64,
    kind: ExpressionKind,
    seconds: f64,
) -> Vec<Bump> {
    let frames = motion.len();
    let mut fitted = filtered(motion, &weights(kind, seconds, fps));
    without_lids(&mut fitted);
    let heights: Vec<[f64; 16]> =
        fitted.iter().map(|regions| regions.map(|[u, v]| libm::hypot(u, v))).collect();
    let noise: [f64; 16] = std::array::from_fn(|region| {
        let known = || fitted.iter().zip(usable).filter(|(_, usable)| **usable);
        let of = |axis: usize| deviation(known().map(|(regions, _)| regions[region][axis]));
        ((of(0) + of(1)) / 2.0).max(LEAST_NOISE * side)
    });
    let surroundings = match kind {
        ExpressionKind::Micro => Some(Surroundings::of(&heights, fps, seconds)),
        ExpressionKind::Macro => None,
    };
    let score = |frame: usize, region: usize| {
        let around =
            surroundings.as_ref().map_or(0.0, |around| SURROUNDINGS * around.deviation(frame, region));
        heights[frame][region] / libm::hypot(noise[region], around)
    };
    let others = || (0..REGIONS.len()).filter(|region| !LIDS.contains(region));
    let best: Vec<(f64, usize)> = (0..frames)
        .map(|frame| {
            let scores = others().map(|region| (score(frame, region), region));
            scores.fold((0.0, 0), |best, other| if other.0 > best.0 { other } else { best })
        })
        .collect();
    let least = side * if kind == ExpressionKind::Micro { LEAST_MICRO } else { LEAST_MACRO };
    let mut found = Vec::new();
    for at in 1..frames.saturating_sub(1) {
        let (score, region) = best[at];
        if score < best[at - 1].0 || score <= best[at + 1].0 {
            continue;
        }
        let height = heights[at][region];
        let lids = LIDS.iter().map(|lid| heights[at][*lid]).fold(0.0, f64::max);
        let hidden = kind == ExpressionKind::Micro && height <= LEAST_OF_LIDS * lids;
        let too_far = kind == ExpressionKind::Micro && height > LARGEST_MICRO * side;
        if height > least && !hidden && !too_far {
            found.push(Bump { kind, seconds, at, region, height, lids, score });
        }
    }
    found
}

impl Bump {
    fn rank(&self) -> f64 {
        match self.kind {
            ExpressionKind::Micro => self.score,
            ExpressionKind::Macro => self.score * MACRO_WEIGHT,
        }
    }

    /// With its first and last frame; `None` where it is too long or short for its kind.
    fn event(&self, motion: &[RegionMotion], fps: f64) -> Option<SpottedEvent> {
        let last = motion.len() - 1;
        let (onset, apex, offset) = match self.kind {
            ExpressionKind::Macro => {
                let half = self.seconds * fps / 2.0;
                (self.at as f64 - half, self.at, self.at as f64 + half)
            }
            ExpressionKind::Micro => self.refined(motion, fps)?,
        };
        let within = |frame: f64| (frame.round().max(0.0) as usize).min(last);
        Some(SpottedEvent {
            kind: self.kind,
            onset: within(onset),
            apex,
            offset: within(offset),
            region: REGIONS[self.region],
            height_px: self.height,
            score: self.score,
            with_lids: self.lids > self.height,
        })
    }

    /// Onset, apex and offset of a short bump, from where the region has moved half as far as at its apex.
    fn refined(&self, motion: &[RegionMotion], fps: f64) -> Option<(f64, usize, f64)> {
        let half = (self.seconds * fps / 2.0).round() as usize + 1;
        let reach = ((0.5 * fps) as usize).max(half + 1);
        let last = motion.len() - 1;
        let place = |frame: usize| motion[frame][self.region];
        let (first, end) = (self.at.saturating_sub(reach), (self.at + reach).min(last));
        let median_place = |frames: std::ops::RangeInclusive<usize>| {
            [0, 1].map(|axis| median(frames.clone().map(|frame| place(frame)[axis])))
        };
        let before = median_place(first..=self.at.saturating_sub(half).max(first));
        let after = median_place((self.at + half).min(end)..=end);
        let rest = [0, 1].map(|axis| (before[axis] + after[axis]) / 2.0);
        let about = self.at.saturating_sub(1)..=(self.at + 1).min(last);
        let count = about.clone().count() as f64;
        let moved = [0, 1]
            .map(|axis| about.clone().map(|frame| place(frame)[axis]).sum::<f64>() / count - rest[axis]);
        let far = libm::hypot(moved[0], moved[1]);
        if far <= 0.0 {
            return None;
        }
        let along = |frame: usize| {
            let [u, v] = place(frame);
            ((u - rest[0]) * moved[0] + (v - rest[1]) * moved[1]) / far
        };
        let near = self.at.saturating_sub(3)..=(self.at + 3).min(last);
        let apex = near.fold(self.at, |best, frame| if along(frame) > along(best) { frame } else { best });
        let half_height = along(apex) / 2.0;
        // Frames from the apex to half its height, with the part of the last step.
        let to_half = |towards: &dyn Fn(usize) -> Option<usize>| {
            let (mut frame, mut steps) = (apex, 0.0);
            while let Some(next) = towards(frame).filter(|next| next.abs_diff(apex) <= reach) {
                if along(next) <= half_height {
                    let drop = (along(frame) - along(next)).max(f64::MIN_POSITIVE);
                    return steps + ((along(frame) - half_height) / drop).clamp(0.0, 1.0);
                }
                steps += 1.0;
                frame = next;
            }
            steps
        };
        let rise = to_half(&|frame| frame.checked_sub(1));
        let fall = to_half(&|frame| Some(frame + 1).filter(|next| *next <= last));
        let (onset, offset) = (apex as f64 - ONSET_OF_HALF * rise, apex as f64 + ONSET_OF_HALF * fall);
        let seconds = (offset - onset) / fps;
        (SHORTEST_SECONDS..=LONGEST_MICRO_SECONDS).contains(&seconds).then_some((onset, apex, offset))
    }
}

/// Weights of the frames about a moment whose sum is the height of a bump there, by least squares with a constant and a slope.
fn weights(kind: ExpressionKind, seconds: f64, fps: f64) -> Vec<f64> {
    let length = seconds * fps;
    let margin = match kind {
        ExpressionKind::Micro => MICRO_MARGIN_SECONDS,
        ExpressionKind::Macro => MACRO_MARGIN_SECONDS,
    };
    let reach = (length / 2.0).ceil() as i64 + ((margin * fps).round() as i64).max(2);
    let bump = |time: f64| match kind {
        ExpressionKind::Micro if time.abs() < length / 2.0 => 0.5 + 0.5 * (2.0 * PI * time / length).cos(),
        ExpressionKind::Micro => 0.0,
        ExpressionKind::Macro => {
            let share = ((length / 2.0 - time.abs()) / (RAMP * length)).clamp(0.0, 1.0);
            0.5 - 0.5 * (PI * share).cos()
        }
    };
    let terms: Vec<[f64; 3]> =
        (-reach..=reach).map(|time| [bump(time as f64), 1.0, time as f64 / reach as f64]).collect();
    let mut normal = vec![0.0; 9];
    for term in &terms {
        for (place, sum) in normal.iter_mut().enumerate() {
            *sum += term[place / 3] * term[place % 3];
        }
    }
    // A bump, a constant and a slope over at least five frames are independent.
    let inverse = dense::inverse(normal, 3).unwrap_or_else(|| vec![0.0; 9]);
    terms.iter().map(|term| (0..3).map(|other| inverse[other] * term[other]).sum()).collect()
}

/// The motion weighted about every frame. Beyond its ends the face is at rest.
fn filtered(motion: &[RegionMotion], weights: &[f64]) -> Vec<RegionMotion> {
    let reach = (weights.len() / 2).cast_signed();
    let last = motion.len().cast_signed() - 1;
    let at = |frame: usize| {
        let mut sum = [[0.0; 2]; 16];
        for (step, weight) in (-reach..=reach).zip(weights) {
            let place = (frame.cast_signed() + step).clamp(0, last).cast_unsigned();
            let values = motion[place].as_flattened();
            sum.as_flattened_mut().iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
        }
        sum
    };
    (0..motion.len()).into_par_iter().map(at).collect()
}

/// Takes the part of every region's motion out that follows the lids, as it does where they move most.
fn without_lids(motion: &mut [RegionMotion]) {
    const ROUNDS: usize = 8;
    let lids = |regions: &RegionMotion| {
        let [left, right] = LIDS.map(|lid| regions[lid]);
        [left[0], left[1], right[0], right[1]]
    };
    let length = |regions: &RegionMotion| lids(regions).iter().map(|value| value * value).sum::<f64>();
    let mut lengths: Vec<f64> = motion.iter().map(length).collect();
    lengths.sort_by(f64::total_cmp);
    let Some(&least) = lengths.get(lengths.len() * 4 / 5) else { return };
    let moving: Vec<RegionMotion> =
        motion.iter().filter(|regions| length(regions) > least).copied().collect();
    if moving.len() < 8 {
        return;
    }
    for region in (0..REGIONS.len()).filter(|region| !LIDS.contains(region)) {
        let mut closeness = vec![1.0; moving.len()];
        let mut follow = [[0.0; 2]; 4];
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (vec![0.0; 16], [0.0; 8]);
            for (regions, weight) in moving.iter().zip(&closeness) {
                let lids = lids(regions);
                for (i, lid) in lids.iter().enumerate() {
                    (0..4).for_each(|j| normal[4 * i + j] += weight * lid * lids[j]);
                    (0..2).for_each(|axis| right[2 * i + axis] += weight * lid * regions[region][axis]);
                }
            }
            let scale = (0..4).map(|i| normal[5 * i]).fold(0.0, f64::max);
            (0..4).for_each(|i| normal[5 * i] += 1e-6 * scale + f64::MIN_POSITIVE);
            let Some(inverse) = dense::inverse(normal, 4) else { return };
            let solved = dense::product(&inverse, &right, 4, 2);
            follow = std::array::from_fn(|lid| [solved[2 * lid], solved[2 * lid + 1]]);
            let rests: Vec<f64> =
                moving.iter().map(|regions| rest(regions[region], &lids(regions), &follow)).collect();
            let scale = 2.0 * 1.48 * median(rests.iter().copied()) + 1e-6;
            closeness = rests.iter().map(|rest| (1.0 + (rest / scale).powi(2)).powi(-2)).collect();
        }
        for regions in motion.iter_mut() {
            let lids = lids(regions);
            for axis in 0..2 {
                regions[region][axis] -= (0..4).map(|lid| follow[lid][axis] * lids[lid]).sum::<f64>();
            }
        }
    }
}

/// Length of what the lids do not explain.
fn rest(moved: [f64; 2], lids: &[f64; 4], follow: &[[f64; 2]; 4]) -> f64 {
    let [u, v] = [0, 1].map(|axis| {
        moved[axis] - lids.iter().zip(follow).map(|(lid, follow)| lid * follow[axis]).sum::<f64>()
    });
    libm::hypot(u, v)
}

/// Mean squares of the bumps near every frame.
struct Surroundings {
    /// Sums of squares before each frame.
    sums: Vec<[f64; 16]>,
    reach: usize,
    guard: usize,
}

impl Surroundings {
    fn of(heights: &[[f64; 16]], fps: f64, seconds: f64) -> Self {
        let mut sums = vec![[0.0; 16]];
        let mut sum = [0.0; 16];
        for heights in heights {
            sum.iter_mut().zip(heights).for_each(|(sum, height)| *sum += height * height);
            sums.push(sum);
        }
        let frames = |seconds: f64| (seconds * fps) as usize;
        Self { sums, reach: frames(SURROUNDING_SECONDS), guard: frames(seconds / 2.0 + GUARD_SECONDS) }
    }

    fn deviation(&self, frame: usize, region: usize) -> f64 {
        let frames = self.sums.len() - 1;
        let within = |reach: usize| {
            let (first, end) = (frame.saturating_sub(reach), (frame + reach + 1).min(frames));
            (self.sums[end][region] - self.sums[first][region], end - first)
        };
        let ((sum, count), (near, near_count)) = (within(self.reach), within(self.guard));
        ((sum - near).max(0.0) / (count - near_count).max(1) as f64).sqrt()
    }
}

/// Deviation of most values, from the median of their distances to their median.
fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let middle = median(values.clone());
    1.4826 * median(values.map(|value| (value - middle).abs()))
}
