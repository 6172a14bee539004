//! Examining an SRFlow dataset: is every file there and sound, and does the flow explain the frames?

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use srflow_field::{FlowField, Image, Mask, read_flow, read_image, read_mask, warp};

use crate::record::PairRecord;
use crate::statistics::{FlowSummary, Statistics};
use srflow_read::manifest::{FrameFiles, Manifest, ManifestError, SceneEntry};

/// The most pairs examined at once, each with about 0.3 GB at 2200x3208.
const MAX_AT_ONCE: usize = 16;

/// Flow is wrong when warping by it leaves more than this many times the difference that there was without, plus a
/// level. Flow that points the wrong way about doubles it.
const WORST_RATIO: f64 = 1.05;
const WORST_LEVELS: f64 = 0.5;

/// Something that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file or folder.
    pub file: PathBuf,
    /// What is wrong with it.
    pub what: String,
}

/// Mean absolute difference between frame 1 and frame 2 over colour channels, in levels of 0 to 255: on the head and
/// where frame 2 shows what frame 1 does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Residual {
    /// Pixels that were compared.
    pub pixels: u64,
    /// With frame 2 warped back by the flow.
    pub warped: f64,
    /// With frame 2 as it is.
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

/// What [`check`] found.
#[derive(Debug, Clone, Serialize)]
pub struct CheckReport {
    /// Pairs that the dataset should have.
    pub pairs: u64,
    /// Pairs without any problem.
    pub sound: u64,
    /// Over all pairs that could be compared.
    pub residual: Residual,
    /// Everything that is wrong, by file.
    pub problems: Vec<Problem>,
    /// What the dataset holds, as its flow files say.
    pub statistics: Statistics,
}

/// Opens every file of the dataset in `dir`, with the threads of the current rayon pool. `on_pair` is called after every
/// pair.
///
/// # Errors
/// When there is no `dataset.json` that can be read. All else that is wrong is in the report.
pub fn check(dir: &Path, on_pair: &(dyn Fn() + Sync)) -> Result<CheckReport, ManifestError> {
    let manifest = Manifest::read(dir)?;
    let pairs: Vec<(&SceneEntry, u32)> =
        manifest.scenes.iter().flat_map(|scene| (0..scene.pairs).map(move |pair| (scene, pair))).collect();
    let at_once = rayon::current_num_threads().min(MAX_AT_ONCE);
    let mut report = CheckReport {
        pairs: manifest.pairs(),
        sound: 0,
        residual: Residual::default(),
        problems: unexpected_files(dir, &manifest),
        statistics: Statistics::new(&manifest, FlowSummary::default()),
    };
    let mut flow = FlowSummary::default();
    // In groups, so that not every thread holds a pair; summed up in order, so that threads do not change the result.
    for group in pairs.chunks(at_once) {
        let found: Vec<PairFindings> = group
            .par_iter()
            .map(|(scene, pair)| {
                let findings = examine(dir, &manifest, scene, *pair);
                on_pair();
                findings
            })
            .collect();
        for findings in found {
            report.sound += u64::from(findings.problems.is_empty());
            report.problems.extend(findings.problems);
            report.residual.add(&findings.residual);
            flow.add(&findings.flow);
        }
    }
    report.statistics = Statistics::new(&manifest, flow);
    Ok(report)
}

/// What was found of one pair.
#[derive(Default)]
struct PairFindings {
    problems: Vec<Problem>,
    residual: Residual,
    flow: FlowSummary,
}

impl PairFindings {
    fn problem(&mut self, file: &Path, what: impl Into<String>) {
        self.problems.push(Problem { file: file.to_owned(), what: what.into() });
    }

    /// What a file holds, when it can be read and is of the dataset's size.
    fn read<T>(
        &mut self,
        file: &Path,
        size: (usize, usize),
        read: impl FnOnce(&Path) -> Result<T, srflow_field::FileError>,
        size_of: impl Fn(&T) -> (usize, usize),
    ) -> Option<T> {
        match read(file) {
            Err(error) => {
                let problem = error.problem.to_string();
                self.problem(file, if file.exists() { problem } else { "the file is missing".to_owned() });
                None
            }
            Ok(content) if size_of(&content) != size => {
                let (width, height) = size_of(&content);
                self.problem(
                    file,
                    format!(
                        "expected {}x{} as in dataset.json, found {width}x{height} (WIDTHxHEIGHT)",
                        size.0, size.1
                    ),
                );
                None
            }
            Ok(content) => Some(content),
        }
    }

    fn read_image(&mut self, file: &Path, size: (usize, usize)) -> Option<Image> {
        self.read(file, size, read_image, Image::size)
    }

    fn read_mask(&mut self, file: &Path, size: (usize, usize)) -> Option<Mask> {
        self.read(file, size, read_mask, Mask::size)
    }

    fn read_flow(&mut self, file: &Path, size: (usize, usize)) -> Option<FlowField> {
        let flow = self.read(file, size, read_flow, FlowField::size)?;
        let unknown = flow.pixels().iter().filter(|[u, v]| !(u.is_finite() && v.is_finite())).count();
        if unknown > 0 {
            self.problem(file, format!("{unknown} pixels without flow, expected none"));
            return None;
        }
        Some(flow)
    }

    /// The files of a frame; gives its mask.
    fn examine_frame(&mut self, files: &FrameFiles, size: (usize, usize)) -> Option<Mask> {
        let mask = self.read_mask(&files.mask, size);
        // Alpha is rounded so that its upper half is the mask.
        let alpha = self.read_mask(&files.alpha, size);
        if let (Some(mask), Some(alpha)) = (&mask, &alpha)
            && mask != alpha
        {
            let differ =
                mask.pixels().iter().zip(alpha.pixels()).filter(|(mask, alpha)| mask != alpha).count();
            self.problem(&files.mask, format!("differs from alpha above one half in {differ} pixels"));
        }
        if let Some(depth) = &files.depth {
            self.read_image(depth, size);
        }
        mask
    }
}

fn examine(dir: &Path, manifest: &Manifest, scene: &SceneEntry, pair: u32) -> PairFindings {
    let mut findings = PairFindings::default();
    let size = (manifest.arguments.width, manifest.arguments.height);
    let files = manifest.files(dir, scene, pair);
    let mask = findings.examine_frame(&manifest.frame_files(dir, scene, pair), size);
    if pair + 1 == scene.pairs {
        findings.examine_frame(&manifest.frame_files(dir, scene, pair + 1), size);
    }
    let frame1 = findings.read_image(&files.frame1, size);
    // The next pair reports its own first frame when it is broken.
    let mut of_frame2 = PairFindings::default();
    let frame2 = of_frame2.read_image(&files.frame2, size);
    if pair + 1 == scene.pairs {
        findings.problems.append(&mut of_frame2.problems);
    }
    let flow = findings.read_flow(&files.flow, size);
    if let Some(path) = &files.flow_backward {
        findings.read_flow(path, size);
    }
    let occlusion = findings.read_mask(&files.occlusion, size);
    let record = PairRecord::read(&files.record);
    if let Err(error) = &record {
        let missing = !files.record.exists();
        findings.problem(&files.record, if missing { "the file is missing" } else { &error.reason });
    }
    let (Some(flow), Some(mask), Some(occlusion)) = (flow, mask, occlusion) else { return findings };
    findings.flow = FlowSummary::of(&flow, &mask, &occlusion);
    if let Ok(record) = record {
        compare(&mut findings, &record, &files.record, pair);
    }
    if let (Some(frame1), Some(frame2)) = (frame1, frame2) {
        findings.residual = residual(&frame1, &frame2, &flow, &mask, &occlusion);
        if findings.residual.is_wrong() {
            let Residual { warped, unwarped, .. } = findings.residual;
            let what = format!(
                "the flow does not explain the frames: the mean difference is {warped:.2} levels with frame 2 warped by it, {unwarped:.2} without"
            );
            findings.problem(&files.flow, what);
        }
    }
    findings
}

/// Holds a record against the files that it speaks of.
fn compare(findings: &mut PairFindings, record: &PairRecord, file: &Path, pair: u32) {
    let frames = (record.frame1.frame, record.frame2.frame);
    if frames != (pair, pair + 1) {
        let what = format!("is of frames {} and {}, expected {pair} and {}", frames.0, frames.1, pair + 1);
        findings.problem(file, what);
    }
    let (written, found) = (&record.flow, findings.flow.clone());
    if (written.pixels, written.occluded) != (found.pixels, found.occluded) {
        let what = format!(
            "says {} pixels of which {} are occluded, the mask and occlusion files have {} and {}",
            written.pixels, written.occluded, found.pixels, found.occluded
        );
        findings.problem(file, what);
    }
    // Stored flow is rounded, by up to 1/128 px in the coarsest format.
    if (written.mean() - found.mean()).abs() > 0.01 + 0.001 * written.mean() {
        let what =
            format!("says a mean flow of {:.4} px, the flow file has {:.4}", written.mean(), found.mean());
        findings.problem(file, what);
    }
}

fn residual(frame1: &Image, frame2: &Image, flow: &FlowField, mask: &Mask, occlusion: &Mask) -> Residual {
    let Ok((warped, inside)) = warp(frame2, flow) else { return Residual::default() };
    let (mut pixels, mut with, mut without) = (0_u64, 0_u64, 0_u64);
    let difference =
        |a: &[u8; 3], b: &[u8; 3]| -> u64 { a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum() };
    for (i, frame1) in frame1.pixels().iter().enumerate() {
        if mask.pixels()[i] && inside.pixels()[i] && !occlusion.pixels()[i] {
            pixels += 1;
            with += difference(frame1, &warped.pixels()[i]);
            without += difference(frame1, &frame2.pixels()[i]);
        }
    }
    let mean = |sum: u64| if pixels == 0 { 0.0 } else { sum as f64 / (3 * pixels) as f64 };
    Residual { pixels, warped: mean(with), unwarped: mean(without) }
}

/// Files in the scenes' folders that the dataset does not speak of.
fn unexpected_files(dir: &Path, manifest: &Manifest) -> Vec<Problem> {
    let mut problems = Vec::new();
    for scene in &manifest.scenes {
        let mut folders = BTreeSet::new();
        let mut expected = BTreeSet::new();
        for pair in 0..scene.pairs {
            let of_last = manifest.frame_files(dir, scene, pair + 1);
            expected.extend(manifest.files(dir, scene, pair).all().chain(of_last.all()).cloned());
        }
        folders.extend(expected.iter().filter_map(|file| file.parent()));
        for folder in folders {
            let Ok(entries) = fs::read_dir(folder) else { continue }; // its files are reported as missing
            let found: BTreeSet<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
            problems.extend(found.difference(&expected).map(|file| {
                Problem {
                    file: file.clone(),
                    what:
                        "no file of this dataset; a killed run leaves such ones, which the next run removes"
                            .into(),
                }
            }));
        }
    }
    problems
}
