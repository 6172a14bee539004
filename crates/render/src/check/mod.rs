//! Checks an SRFlow dataset: whether every file that `srflow render` writes exists and matches the dataset's arguments, and
//! whether the flow explains the frames.

mod again;
mod plan;
mod problem;

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use srflow_core::{FlowField, Image, Labels, Mask, Plane, Size, warp};
use srflow_files::{FileKind, parse_error_in_words, read_alpha, read_flow, read_image, read_mask, read_text};

use crate::camera::camera_from_record;
use crate::job::first_difference;
use crate::record::PairRecord;
use crate::statistics::{BINS, FlowSummary, Statistics, bin_edges};
pub use again::{Rerendered, check_hashes, check_rerendered};
use plan::{Expected, problems_of_manifest, unexpected_files};
pub use problem::Problem;
use srflow_data::manifest::{FrameFiles, Manifest, ManifestError, STATISTICS_NAME, SceneEntry};
use srflow_data::region_map::read_region_map;

/// Maximum number of pairs examined at once, each with about 0.3 GB at 2200x3208.
const MAX_AT_ONCE: usize = 16;

/// Pairs that one thread examines in a row: the second frame of one is the first of the next.
const RUN: u32 = 6;

/// Flow is wrong when warping by it leaves more than this multiple of the difference without warping, plus one level. Flow
/// with the wrong sign doubles the difference.
const WORST_RATIO: f64 = 1.05;
const WORST_LEVELS: f64 = 0.5;

/// Mean absolute difference between frame 1 and frame 2 over colour channels, in levels of 0 to 255: on the head, where the
/// pixel is visible in both frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Residual {
    /// Number of compared pixels.
    pub pixels: u64,
    /// With frame 2 warped back by the flow.
    pub warped: f64,
    /// With the original frame 2.
    pub unwarped: f64,
}

impl Residual {
    fn add(&mut self, other: &Self) {
        let pixels = self.pixels + other.pixels;
        if pixels > 0 {
            let share = other.pixels as f64 / pixels as f64;
            self.warped += share * (other.warped - self.warped);
            self.unwarped += share * (other.unwarped - self.unwarped);
        }
        self.pixels = pixels;
    }

    fn is_wrong(&self) -> bool {
        self.warped > WORST_RATIO * self.unwarped + WORST_LEVELS
    }
}

/// The result of [`check`].
#[derive(Debug, Clone, Serialize)]
pub struct CheckReport {
    /// Number of pairs the dataset should have.
    pub pairs: u64,
    /// Number of pairs without problems.
    pub sound: u64,
    /// Over all pairs that could be compared.
    pub residual: Residual,
    /// All problems, by file.
    pub problems: Vec<Problem>,
    /// Statistics computed from the flow files.
    pub statistics: Statistics,
}

/// Opens every file of the dataset in `dir`, with the threads of the current rayon pool. Calls `on_pair` after every pair.
///
/// # Errors
/// When `dataset.json` cannot be read. All other problems are in the report.
pub fn check(dir: &Path, on_pair: &(dyn Fn() + Sync)) -> Result<CheckReport, ManifestError> {
    let manifest = Manifest::read(dir)?;
    let mut report = CheckReport {
        pairs: manifest.pairs(),
        sound: 0,
        residual: Residual::default(),
        problems: problems_of_manifest(dir, &manifest),
        statistics: Statistics::new(&manifest, FlowSummary::default()),
    };
    if !report.problems.is_empty() {
        return Ok(report); // nothing can be compared with a wrong plan
    }
    report.problems = unexpected_files(dir, &manifest);
    let at_once = rayon::current_num_threads().min(MAX_AT_ONCE) as u32;
    let mut flow = FlowSummary::default();
    let mut recorded = Some(FlowSummary::default());
    for (number, scene) in (0..).zip(&manifest.scenes) {
        let expected = Expected::of_scene(&manifest, number, scene);
        let checker = PairChecker { dir, manifest: &manifest, scene, expected: expected.as_ref() };
        // In groups, to limit the pairs in memory; summed up in order, so that the result does not depend on the threads.
        let length = RUN.min(scene.pairs.div_ceil(at_once).max(1));
        for first in (0..scene.pairs).step_by((at_once * length) as usize) {
            let runs = (0..at_once).map(|run| first.saturating_add(run * length));
            let runs: Vec<u32> = runs.filter(|first| *first < scene.pairs).collect();
            let examine = |first: u32| -> Vec<PairFindings> {
                let mut frame = None;
                let examine = |pair| {
                    let findings = checker.examine(pair, &mut frame);
                    on_pair();
                    findings
                };
                (first..scene.pairs.min(first.saturating_add(length))).map(examine).collect()
            };
            let found: Vec<Vec<PairFindings>> = runs.into_par_iter().map(examine).collect();
            for findings in found.into_iter().flatten() {
                report.sound += u64::from(findings.problems.is_empty());
                report.problems.extend(findings.problems);
                report.residual.add(&findings.residual);
                flow.add(&findings.flow);
                recorded = recorded.zip(findings.recorded).map(|(mut sum, pair)| {
                    sum.add(&pair);
                    sum
                });
            }
        }
    }
    report.problems.extend(problem_of_statistics(dir, &manifest, recorded));
    report.statistics = Statistics::new(&manifest, flow);
    Ok(report)
}

/// Problems of `statistics.json`, which sums up all records; if one of these is missing, only its syntax is checked.
fn problem_of_statistics(dir: &Path, manifest: &Manifest, recorded: Option<FlowSummary>) -> Option<Problem> {
    let file = dir.join(STATISTICS_NAME);
    let text = match read_text(&file, FileKind::Json) {
        Ok(text) => text,
        Err(_) if !file.exists() => {
            let what = "the file is missing; `srflow render` with the same arguments writes it".to_owned();
            return Some(Problem { file, what });
        }
        Err(error) => return Some(Problem { what: error.problem.to_string(), file }),
    };
    let found: Statistics = match serde_json::from_str(&text) {
        Ok(found) => found,
        Err(error) => return Some(Problem { what: parse_error_in_words(&error), file }),
    };
    let expected = Statistics::new(manifest, recorded?);
    let value = |statistics| serde_json::to_value(statistics).unwrap_or_default();
    let (field, found, expected) = first_difference(&value(&found), &value(&expected))?;
    Some(Problem { file, what: format!("{field} {found}, the records of all pairs give {expected}") })
}

/// The findings of one pair.
#[derive(Default)]
struct PairFindings {
    problems: Vec<Problem>,
    residual: Residual,
    flow: FlowSummary,
    /// The flow summary in the pair's record.
    recorded: Option<FlowSummary>,
}

impl PairFindings {
    fn problem(&mut self, file: &Path, what: impl Into<String>) {
        self.problems.push(Problem { file: file.to_owned(), what: what.into() });
    }

    /// The content of a file, if it can be read and has the dataset's size.
    fn read<T>(
        &mut self,
        file: &Path,
        size: Size,
        read: impl FnOnce(&Path) -> Result<T, srflow_files::FileError>,
        size_of: impl Fn(&T) -> Size,
    ) -> Option<T> {
        match read(file) {
            Err(error) => {
                let problem = error.problem.to_string();
                self.problem(file, if file.exists() { problem } else { "the file is missing".to_owned() });
                None
            }
            Ok(content) if size_of(&content) != size => {
                let found = size_of(&content);
                let what = format!("expected {size} as in dataset.json, found {found} (WIDTHxHEIGHT)");
                self.problem(file, what);
                None
            }
            Ok(content) => Some(content),
        }
    }

    fn read_image(&mut self, file: &Path, size: Size) -> Option<Image> {
        self.read(file, size, read_image, Image::size)
    }

    fn read_mask(&mut self, file: &Path, size: Size) -> Option<Mask> {
        self.read(file, size, read_mask, Mask::size)
    }

    fn read_flow(&mut self, file: &Path, size: Size) -> Option<FlowField> {
        let flow = self.read(file, size, read_flow, FlowField::size)?;
        let unknown = flow.pixels().iter().filter(|[u, v]| !(u.is_finite() && v.is_finite())).count();
        if unknown > 0 {
            self.problem(file, format!("{unknown} pixels without flow, expected none"));
            return None;
        }
        Some(flow)
    }

    /// Reports parts of a flow that do not add up to it. `file` is that of the expression's.
    fn add_up(&mut self, flow: &FlowField, head: &FlowField, expression: &FlowField, file: &Path) {
        // Each of the three files is rounded.
        let near = |flow: f32, head: f32, expression: f32| {
            (flow - head - expression).abs() <= 3.0 * ROUNDING + 0.001 * flow.abs().max(head.abs())
        };
        let parts = head.pixels().iter().zip(expression.pixels());
        let differ = flow.pixels().iter().zip(parts).filter(|(flow, (head, expression))| {
            !(0..2).all(|axis| near(flow[axis], head[axis], expression[axis]))
        });
        let count = differ.count();
        if count > 0 {
            let what = format!("it and the flow of the head do not add up to the flow in {count} pixels");
            self.problem(file, what);
        }
    }

    /// Reports a flow that does not explain the frames.
    fn explains(&mut self, residual: Residual, file: &Path) {
        if residual.is_wrong() {
            let Residual { warped, unwarped, .. } = residual;
            let what = format!(
                "the flow does not explain the frames: the mean difference is {warped:.2} levels with the other frame warped by it, {unwarped:.2} without"
            );
            self.problem(file, what);
        }
    }

    /// Checks the files of a frame; returns its mask.
    fn examine_frame(&mut self, files: &FrameFiles, size: Size) -> Option<Mask> {
        let mask = self.read_mask(&files.mask, size);
        // Alpha is rounded such that its upper half is exactly the mask.
        let alpha = self.read(&files.alpha, size, read_alpha, Plane::size);
        if let (Some(mask), Some(alpha)) = (&mask, &alpha) {
            let covered = alpha.pixels().iter().map(|alpha| *alpha > 0.5);
            let differ = covered.zip(mask.pixels()).filter(|(covered, inside)| covered != *inside).count();
            if differ > 0 {
                self.problem(&files.mask, format!("differs from alpha above one half in {differ} pixels"));
            }
        }
        if let Some(path) = &files.depth
            && let Some(depth) = self.read_image(path, size)
        {
            let shown = depth.pixels().iter().map(|depth| depth[0] > 0);
            self.agrees_with_mask("depth", path, shown, mask.as_ref());
        }
        if let Some(path) = &files.regions
            && let Some(map) = self.read(path, size, read_region_map, Labels::size)
        {
            let shown = map.pixels().iter().map(|&label| label > 0);
            self.agrees_with_mask("region map", path, shown, mask.as_ref());
        }
        mask
    }

    /// Reports a file that shows the head elsewhere than the mask does.
    fn agrees_with_mask(
        &mut self,
        what: &str,
        file: &Path,
        shown: impl Iterator<Item = bool>,
        mask: Option<&Mask>,
    ) {
        let Some(mask) = mask else { return };
        let differ = shown.zip(mask.pixels()).filter(|(shown, inside)| shown != *inside).count();
        if differ > 0 {
            self.problem(file, format!("{what} and mask contradict each other in {differ} pixels"));
        }
    }
}

/// What the pairs of a scene are checked against.
struct PairChecker<'a> {
    dir: &'a Path,
    manifest: &'a Manifest,
    scene: &'a SceneEntry,
    expected: Option<&'a Expected>,
}

impl PairChecker<'_> {
    /// `frame` is the first frame, if the pair before has read it as its second, and then the second of this one.
    fn examine(&self, pair: u32, frame: &mut Option<Image>) -> PairFindings {
        let Self { dir, manifest, scene, .. } = *self;
        let known = frame.take();
        let mut findings = PairFindings::default();
        let size = Size::new(manifest.arguments.width, manifest.arguments.height);
        let files = manifest.files(dir, scene, pair);
        // One problem, so that those of a million pairs fit into memory.
        if !files.record.exists() && !files.all().any(|file| file.exists()) {
            findings.problem(&files.record, "all files of this pair are missing");
            return findings;
        }
        let mask = findings.examine_frame(&manifest.frame_files(dir, scene, pair), size);
        let frame1 = known.or_else(|| findings.read_image(&files.frame1, size));
        // The next pair reports its own first frame if it is broken.
        let mut of_frame2 = PairFindings::default();
        let of_last = pair + 1 == scene.pairs;
        let mask2 = (of_last || manifest.arguments.backward)
            .then(|| of_frame2.examine_frame(&manifest.frame_files(dir, scene, pair + 1), size))
            .flatten();
        let frame2 = of_frame2.read_image(&files.frame2, size);
        if of_last {
            findings.problems.append(&mut of_frame2.problems);
        }
        let flow = findings.read_flow(&files.flow, size);
        let part = |path: &Option<PathBuf>, findings: &mut PairFindings| {
            path.as_ref().and_then(|path| findings.read_flow(path, size))
        };
        let head_flow = part(&files.head_flow, &mut findings);
        let expression_flow = part(&files.expression_flow, &mut findings);
        if let (Some(path), Some(flow), Some(head), Some(expression)) =
            (&files.expression_flow, &flow, &head_flow, &expression_flow)
        {
            findings.add_up(flow, head, expression, path);
        }
        let backward = files.flow_backward.as_ref().and_then(|path| findings.read_flow(path, size));
        if let Some(path) = &files.shading_change {
            findings.read_image(path, size);
        }
        let occlusion = findings.read_mask(&files.occlusion, size);
        match PairRecord::read(&files.record) {
            Ok(record) => {
                self.compare_frames(&mut findings, &record, &files.record, pair);
                if let (Some(flow), Some(mask), Some(occlusion)) = (&flow, &mask, &occlusion) {
                    compare_flow(&mut findings, &record.flow, (flow, mask, occlusion), &files.record);
                }
                findings.recorded = Some(record.flow);
            }
            Err(_) if !files.record.exists() => findings.problem(&files.record, "the file is missing"),
            Err(error) => findings.problem(&files.record, error.reason),
        }
        let (Some(flow), Some(mask), Some(occlusion)) = (flow, mask, occlusion) else { return findings };
        findings.flow = FlowSummary::of(&flow, &mask, &occlusion);
        let (Some(frame1), Some(frame2)) = (frame1, frame2) else { return findings };
        findings.residual =
            residual((&frame1, &frame2), &flow, |i| mask.pixels()[i] && !occlusion.pixels()[i]);
        findings.explains(findings.residual, &files.flow);
        if let (Some(path), Some(backward), Some(mask2)) = (&files.flow_backward, backward, mask2) {
            let back = residual((&frame2, &frame1), &backward, |i| mask2.pixels()[i]);
            findings.explains(back, path);
        }
        *frame = Some(frame2);
        findings
    }

    /// Compares the frames in a record with those of the scene.
    fn compare_frames(&self, findings: &mut PairFindings, record: &PairRecord, file: &Path, pair: u32) {
        let frames = (record.frame1.frame, record.frame2.frame);
        if frames != (pair, pair + 1) {
            let what =
                format!("is of frames {} and {}, expected {pair} and {}", frames.0, frames.1, pair + 1);
            findings.problem(file, what);
            return;
        }
        for (name, frame) in [("frame1", &record.frame1), ("frame2", &record.frame2)] {
            let wrong = match self.expected {
                Some(expected) => expected.differs(frame),
                None => camera_from_record(&frame.camera).validate().err().map(|error| error.to_string()),
            };
            if let Some(wrong) = wrong {
                findings.problem(file, format!("{name}: {wrong}"));
            }
        }
    }
}

/// The maximum error of a stored flow in pixels: a step of the coarsest format, 1/64 px, along each axis.
const ROUNDING: f32 = 0.0125;

/// Compares the flow summary of a record with the files.
fn compare_flow(
    findings: &mut PairFindings,
    written: &FlowSummary,
    (flow, mask, occlusion): (&FlowField, &Mask, &Mask),
    file: &Path,
) {
    let found = FlowSummary::of(flow, mask, occlusion);
    if (written.pixels, written.occluded) != (found.pixels, found.occluded) {
        let what = format!(
            "it has {} pixels with {} occluded, the mask and occlusion files have {} and {}",
            written.pixels, written.occluded, found.pixels, found.occluded
        );
        findings.problem(file, what);
        return;
    }
    if (written.mean() - found.mean()).abs() > 0.01 + 0.001 * written.mean() {
        let what =
            format!("it has a mean flow of {:.4} px, the flow file has {:.4}", written.mean(), found.mean());
        findings.problem(file, what);
    }
    if (written.max - found.max).abs() > ROUNDING + 0.001 * found.max {
        let what =
            format!("it has a maximum flow of {:.4} px, the flow file has {:.4}", written.max, found.max);
        findings.problem(file, what);
    }
    // Rounding moves a pixel to another bin only if its flow is at the edge between them.
    let (mut below_written, mut below_found) = (0_u64, 0_u64);
    for bin in 0..BINS {
        below_written = below_written.saturating_add(written.histogram[bin]);
        below_found += found.histogram[bin];
        let edge = bin_edges().get(bin + 1).copied().unwrap_or(f32::INFINITY);
        let at_edge = |&(&[u, v], &inside): &(&[f32; 2], &bool)| {
            inside && edge.is_finite() && (u.hypot(v) - edge).abs() <= ROUNDING + 0.001 * edge
        };
        let differ = below_written.abs_diff(below_found);
        if differ > 0 && differ > flow.pixels().iter().zip(mask.pixels()).filter(at_edge).count() as u64 {
            let what = format!(
                "its histogram has {below_written} pixels below {edge} px, the flow file {below_found}"
            );
            findings.problem(file, what);
            return;
        }
    }
}

/// The mean over `compared` pixels.
fn residual(
    (frame1, frame2): (&Image, &Image),
    flow: &FlowField,
    compared: impl Fn(usize) -> bool,
) -> Residual {
    let Ok((warped, inside)) = warp(frame2, flow) else { return Residual::default() };
    let (mut pixels, mut with, mut without) = (0_u64, 0_u64, 0_u64);
    let difference =
        |a: &[u8; 3], b: &[u8; 3]| -> u64 { a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum() };
    for (i, frame1) in frame1.pixels().iter().enumerate() {
        if inside.pixels()[i] && compared(i) {
            pixels += 1;
            with += difference(frame1, &warped.pixels()[i]);
            without += difference(frame1, &frame2.pixels()[i]);
        }
    }
    let mean = |sum: u64| if pixels == 0 { 0.0 } else { sum as f64 / (3 * pixels) as f64 };
    Residual { pixels, warped: mean(with), unwarped: mean(without) }
}
