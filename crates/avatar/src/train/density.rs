//! Adaptive density control: where pictures pull hard, small Gaussians are cloned and large ones split; transparent and oversized
//! ones are removed, but never the last of a triangle (Kerbl et al. 2023, section 5.2; Qian et al. 2024, section 3.3;
//! `scene/gaussian_model.py` of GaussianAvatars).

use glam::Vec3;
use serde::{Deserialize, Serialize};
use srflow_core::Size;
use srflow_core::random::Stream;
use srflow_files::FileError;
use srflow_splat::{GaussianGradients, Gaussians};

use super::checkpoint::{Checkpoint, Lists};
use super::{GaussianAdam, Mcmc};
use crate::BoundGaussians;

/// What decides where Gaussians are added.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// The length of the gradient of a centre, as in 3D Gaussian Splatting.
    #[default]
    Default,
    /// The same of the sum of absolute values over pixels, which does not cancel (AbsGS, Ye et al. 2024).
    AbsGs,
    /// Transparent Gaussians move to opaque ones; see [`Mcmc`].
    Mcmc,
}

/// When and how Gaussians are added and removed. The defaults are those of GaussianAvatars.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensityControl {
    pub strategy: Strategy,
    /// Gaussians are added and removed after this iteration and before `until`, every `interval`.
    pub from: u64,
    pub until: u64,
    pub interval: u64,
    /// Mean gradient of a centre, in normalised device coordinates, from which on it is cloned or split. Without a value 0.0002 for
    /// `default`, and 0.0008 for `absgs`, as in gsplat.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient_threshold: Option<f32>,
    /// Share of the extent of the cameras up to which a Gaussian is small: it is cloned, not split.
    pub small: f32,
    /// Share of the extent of the cameras from which on a Gaussian is removed, after the first reset of opacities.
    pub large: f32,
    /// Gaussians of a lower opacity are removed.
    pub least_opacity: f32,
    /// All opacities are lowered at multiples of this, but not in the last quarter of a training that is not `faithful`.
    pub reset_interval: u64,
    /// To this at most.
    pub reset_opacity: f32,
    /// Of the strategy `mcmc`, which uses of the others `from`, `until`, `interval` and `least_opacity`.
    pub mcmc: Mcmc,
}

impl Default for DensityControl {
    fn default() -> Self {
        Self {
            strategy: Strategy::Default,
            from: 10_000,
            until: 600_000,
            interval: 2000,
            gradient_threshold: None,
            small: 0.01,
            large: 0.1,
            least_opacity: 0.005,
            reset_interval: 60_000,
            reset_opacity: 0.01,
            mcmc: Mcmc::default(),
        }
    }
}

impl DensityControl {
    /// The gradient from which on a Gaussian is cloned or split.
    pub fn threshold(&self) -> f32 {
        self.gradient_threshold.unwrap_or(match self.strategy {
            Strategy::Default | Strategy::Mcmc => 2e-4,
            Strategy::AbsGs => 8e-4,
        })
    }

    /// Whether Gaussians are added and removed after this iteration.
    pub fn is_due(&self, iteration: u64) -> bool {
        self.from < iteration && iteration < self.until && is_multiple(iteration, self.interval)
    }

    /// Whether opacities are reset after this iteration. Before a white background they are also at `from`.
    pub fn resets(&self, iteration: u64, white: bool) -> bool {
        let due = is_multiple(iteration, self.reset_interval) || white && iteration == self.from;
        self.strategy != Strategy::Mcmc && iteration < self.until && due
    }
}

fn is_multiple(iteration: u64, interval: u64) -> bool {
    iteration.checked_rem(interval) == Some(0)
}

// Names of lists in checkpoints.
const SUMS: &str = "gradient_sums";
const COUNTS: &str = "gradient_counts";

/// How hard the pictures since the last change pull at each Gaussian.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DensityStatistics {
    /// Sums of the lengths of gradients, in normalised device coordinates.
    sums: Vec<f32>,
    /// Pictures that show it.
    counts: Vec<u32>,
}

impl DensityStatistics {
    /// Those of `len` Gaussians that no picture has shown.
    pub fn new(len: usize) -> Self {
        Self { sums: vec![0.0; len], counts: vec![0; len] }
    }

    /// Every list of a checkpoint, by name.
    pub(super) fn lists(&self) -> Lists {
        vec![(SUMS, self.sums.clone()), (COUNTS, self.counts.iter().map(|&count| count as f32).collect())]
    }

    /// Those of a checkpoint, of `len` Gaussians.
    ///
    /// # Errors
    /// When a list is missing or has another length.
    pub(super) fn load(len: usize, checkpoint: &mut Checkpoint) -> Result<Self, FileError> {
        let (sums, counts) = (checkpoint.list(SUMS, Some(len))?, checkpoint.counts(COUNTS, Some(len))?);
        Ok(Self { sums, counts })
    }

    /// Adds one picture of this size, in pixels, which shows the `visible` ones.
    ///
    /// Panics when the lists are shorter than the number of Gaussians.
    pub fn add(&mut self, strategy: Strategy, gradients: &GaussianGradients, visible: &[bool], size: Size) {
        let centers = match strategy {
            Strategy::Default | Strategy::Mcmc => &gradients.centers,
            Strategy::AbsGs => &gradients.centers_absolute,
        };
        let half = 0.5 * glam::Vec2::new(size.width as f32, size.height as f32);
        for (i, (sum, count)) in self.sums.iter_mut().zip(&mut self.counts).enumerate() {
            if visible[i] {
                *sum += (centers[i] * half).length();
                *count += 1;
            }
        }
    }

    /// Mean over the pictures that showed Gaussian number `i`; 0 without one.
    fn mean(&self, i: usize) -> f32 {
        if self.counts[i] == 0 { 0.0 } else { self.sums[i] / self.counts[i] as f32 }
    }
}

/// What one change did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DensityChange {
    /// Gaussians with a copy of themselves.
    pub cloned: usize,
    /// Gaussians replaced by two smaller ones.
    pub split: usize,
    /// Gaussians removed, new ones included.
    pub pruned: usize,
}

/// What a change depends on beside the Gaussians.
#[derive(Debug, Clone, Copy)]
pub struct DensityScene<'a> {
    /// Metres per local unit of each triangle.
    pub units: &'a [f32],
    /// Of the cameras, metres; see [`scene_extent`](super::scene_extent).
    pub extent: f32,
    /// Whether oversized Gaussians are removed.
    pub prune_large: bool,
    /// As the reference does it, with its defects: both parts of a split Gaussian leave its place for the centroid of the triangle,
    /// and their offsets, in metres, are taken for local units; and of a triangle that would become empty no Gaussian is removed.
    pub faithful: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Origin {
    Kept,
    Clone,
    Part,
}

/// One Gaussian after a change.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Heir {
    parent: u32,
    origin: Origin,
    prune: bool,
}

/// The scale of a part over that of the whole: 0.8 times the number of parts.
const SHRINK: f32 = 1.6;
const PARTS: usize = 2;

/// Clones, splits and removes Gaussians, with their state of Adam, and starts new statistics.
///
/// Panics when the lists are not those of the Gaussians and their triangles.
pub fn change_density(
    bound: &mut BoundGaussians,
    adam: &mut GaussianAdam,
    statistics: &mut DensityStatistics,
    control: &DensityControl,
    scene: &DensityScene<'_>,
    stream: &mut Stream,
) -> DensityChange {
    let mut heirs = heirs(bound, statistics, control, scene);
    let count = |heirs: &[Heir], origin| heirs.iter().filter(|heir| heir.origin == origin).count();
    let (cloned, split) = (count(&heirs, Origin::Clone), count(&heirs, Origin::Part) / PARTS);
    let before = heirs.len();
    spare_last(&mut heirs, bound, scene);
    heirs.retain(|heir| !heir.prune);
    let pruned = before - heirs.len();

    let units: Vec<f32> = heirs.iter().map(|heir| unit(bound, scene, heir.parent)).collect();
    let parents: Vec<u32> = heirs.iter().map(|heir| heir.parent).collect();
    bound.inherit(adam, &parents, count(&heirs, Origin::Kept));
    let local = bound.local_mut();
    for (i, _) in heirs.iter().enumerate().filter(|(_, heir)| heir.origin == Origin::Part) {
        let (position, scale) = part(local, i, units[i], scene.faithful, stream);
        local.positions[i] = position;
        adam.set_scale(local, i, scale);
    }
    *statistics = DensityStatistics::new(bound.len());
    DensityChange { cloned, split, pruned }
}

/// Metres per local unit of the triangle of a Gaussian.
fn unit(bound: &BoundGaussians, scene: &DensityScene<'_>, gaussian: u32) -> f32 {
    scene.units[bound.triangles()[gaussian as usize] as usize]
}

/// Position and scale of one part of Gaussian number `i`.
fn part(local: &Gaussians, i: usize, unit: f32, faithful: bool, stream: &mut Stream) -> (Vec3, Vec3) {
    let scale = local.scales[i];
    let sample = Vec3::new(stream.normal(), stream.normal(), stream.normal());
    let rotation = local.rotations[i].normalize();
    let position = if faithful {
        rotation * (sample * scale * unit)
    } else {
        local.positions[i] + rotation * (sample * scale)
    };
    (position, scale / SHRINK)
}

/// All Gaussians after the change, those that survive before the new ones, before any is removed.
fn heirs(
    bound: &BoundGaussians,
    statistics: &DensityStatistics,
    control: &DensityControl,
    scene: &DensityScene<'_>,
) -> Vec<Heir> {
    let local = bound.local();
    let threshold = control.threshold();
    let mut heirs = Vec::with_capacity(local.len());
    let (mut clones, mut parts) = (Vec::new(), Vec::new());
    for parent in 0..local.len() as u32 {
        let i = parent as usize;
        let size = local.scales[i].max_element() * unit(bound, scene, parent);
        let heir = |origin, size: f32| {
            let oversized = scene.prune_large && size > control.large * scene.extent;
            let prune = oversized || local.opacities[i] < control.least_opacity;
            Heir { parent, origin, prune }
        };
        let pulled = statistics.mean(i) >= threshold;
        if pulled && size > control.small * scene.extent {
            parts.extend([heir(Origin::Part, size / SHRINK); PARTS]);
            continue;
        }
        heirs.push(heir(Origin::Kept, size));
        if pulled {
            clones.push(heir(Origin::Clone, size));
        }
    }
    heirs.extend(clones);
    heirs.extend(parts);
    heirs
}

/// The number of the most opaque Gaussian of each of `triangles` triangles, the first of equal ones. `gaussians` are numbers,
/// triangles and opacities.
pub(super) fn most_opaque(
    gaussians: impl Iterator<Item = (usize, usize, f32)>,
    triangles: usize,
) -> Vec<Option<usize>> {
    let mut best: Vec<Option<(usize, f32)>> = vec![None; triangles];
    for (number, triangle, opacity) in gaussians {
        if best[triangle].is_none_or(|(_, most)| opacity > most) {
            best[triangle] = Some((number, opacity));
        }
    }
    best.into_iter().map(|best| best.map(|(number, _)| number)).collect()
}

/// Keeps, on each triangle of which all Gaussians are to be removed, the most opaque one, or as the reference all.
fn spare_last(heirs: &mut [Heir], bound: &BoundGaussians, scene: &DensityScene<'_>) {
    let triangle = |heir: &Heir| bound.triangles()[heir.parent as usize] as usize;
    let opacity = |heir: &Heir| bound.local().opacities[heir.parent as usize];
    let mut has_survivor = vec![false; scene.units.len()];
    heirs.iter().filter(|heir| !heir.prune).for_each(|heir| has_survivor[triangle(heir)] = true);
    let pruned = heirs.iter().enumerate().filter(|(_, heir)| heir.prune);
    let most_opaque =
        most_opaque(pruned.map(|(i, heir)| (i, triangle(heir), opacity(heir))), scene.units.len());
    for (i, heir) in heirs.iter_mut().enumerate() {
        let of = triangle(heir);
        if !has_survivor[of] && (scene.faithful || most_opaque[of] == Some(i)) {
            heir.prune = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec2};
    use srflow_core::random::Key;

    use super::*;

    /// Gaussians on these triangles, of scale 1, opacity 0.5, and position (number, 0, 0).
    fn bound(triangles: &[u32]) -> BoundGaussians {
        let n = triangles.len();
        let local = Gaussians {
            positions: (0..n).map(|i| Vec3::X * i as f32).collect(),
            scales: vec![Vec3::ONE; n],
            rotations: vec![Quat::from_rotation_z(0.4); n],
            opacities: vec![0.5; n],
            sh_degree: 0,
            sh: vec![[0.1; 3]; n],
            antialiased: false,
        };
        BoundGaussians::new(local, triangles.to_vec(), 4).unwrap()
    }

    fn scene(units: &[f32]) -> DensityScene<'_> {
        DensityScene { units, extent: 1.0, prune_large: false, faithful: false }
    }

    struct Changed {
        bound: BoundGaussians,
        change: DensityChange,
    }

    fn changed(mut bound: BoundGaussians, means: &[f32], scene: &DensityScene<'_>) -> Changed {
        let mut adam = GaussianAdam::new(bound.local());
        let mut statistics = DensityStatistics { sums: means.to_vec(), counts: vec![1; means.len()] };
        let mut stream = Key::new(1).stream("density");
        let control = DensityControl::default();
        let change = change_density(&mut bound, &mut adam, &mut statistics, &control, scene, &mut stream);
        assert_eq!(statistics, DensityStatistics::new(bound.len()), "new statistics");
        Changed { bound, change }
    }

    #[test]
    fn statistics_are_means_over_the_pictures_that_show_a_gaussian() {
        let gradients = GaussianGradients {
            centers: vec![Vec2::new(3.0, 4.0), Vec2::X, Vec2::Y],
            centers_absolute: vec![Vec2::splat(7.0); 3],
            ..GaussianGradients::default()
        };
        let mut statistics = DensityStatistics::new(3);
        statistics.add(Strategy::Default, &gradients, &[true, true, false], Size::new(20, 20));
        statistics.add(Strategy::Default, &gradients, &[true, false, false], Size::new(40, 20));
        assert!((statistics.mean(0) - 0.5 * (50.0 + 60.0_f32.hypot(40.0))).abs() < 1e-4);
        assert_eq!((statistics.mean(1), statistics.mean(2)), (10.0, 0.0));
        let mut absolute = DensityStatistics::new(3);
        absolute.add(Strategy::AbsGs, &gradients, &[true; 3], Size::new(2, 2));
        assert!((absolute.mean(2) - 7.0 * 2.0_f32.sqrt()).abs() < 1e-5);
    }

    #[test]
    fn small_gaussians_are_cloned_and_large_ones_split() {
        // In metres 0.005, 0.02 and 0.02, of an extent of 1.
        let units = [0.005, 0.02, 0.02];
        let Changed { bound, change } = changed(bound(&[0, 1, 2]), &[1.0, 1.0, 0.0], &scene(&units));
        assert_eq!(change, DensityChange { cloned: 1, split: 1, pruned: 0 });
        assert_eq!(bound.triangles(), [0, 2, 0, 1, 1], "kept, cloned, split");
        let local = bound.local();
        assert_eq!((local.positions[2], local.scales[2]), (local.positions[0], local.scales[0]));
        for part in 3..5 {
            assert!((local.scales[part] - 1.0 / 1.6).length() < 1e-6);
            assert!(local.positions[part] != Vec3::X && local.opacities[part] == 0.5);
        }
        assert_ne!(local.positions[3], local.positions[4]);
    }

    #[test]
    fn parts_lie_around_their_whole_as_it_is_wide() {
        let mut wide = bound(&[0; 2000]);
        for i in 0..2000 {
            wide.local_mut().positions[i] = Vec3::new(2.0, 0.0, 0.0);
            wide.local_mut().scales[i] = Vec3::new(1.0, 3.0, 0.5);
        }
        let rotation = wide.local().rotations[0];
        let spread = |faithful: bool| {
            let units = [0.1; 4];
            let scene = DensityScene { faithful, ..scene(&units) };
            let Changed { bound, change } = changed(wide.clone(), &[1.0; 2000], &scene);
            assert_eq!((change.split, bound.len()), (2000, 4000));
            let positions = &bound.local().positions;
            let mean = positions.iter().sum::<Vec3>() / 4000.0;
            let own = positions.iter().map(|&position| rotation.inverse() * (position - mean));
            let variance = own.map(|offset| offset * offset).sum::<Vec3>() / 4000.0;
            (mean, variance.map(f32::sqrt))
        };
        let (mean, deviation) = spread(false);
        assert!(mean.distance(Vec3::new(2.0, 0.0, 0.0)) < 0.15, "{mean}");
        assert!((deviation / Vec3::new(1.0, 3.0, 0.5) - 1.0).abs().max_element() < 0.05, "{deviation}");
        let (mean, deviation) = spread(true);
        assert!(mean.length() < 0.02, "the reference forgets the place: {mean}");
        assert!((deviation / Vec3::new(0.1, 0.3, 0.05) - 1.0).abs().max_element() < 0.05, "{deviation}");
    }

    #[test]
    fn no_triangle_is_left_empty() {
        let mut faint = bound(&[0, 0, 0, 1, 1, 2]);
        faint.local_mut().opacities = vec![0.001, 0.003, 0.002, 0.001, 0.9, 0.0];
        let units = [0.001; 4];
        let Changed { bound: kept, change } = changed(faint.clone(), &[0.0; 6], &scene(&units));
        assert_eq!(kept.triangles(), [0, 1, 2]);
        assert_eq!(kept.local().opacities, [0.003, 0.9, 0.0], "the most opaque one");
        assert_eq!(change.pruned, 3);
        let as_reference = DensityScene { faithful: true, ..scene(&units) };
        let Changed { bound: kept, .. } = changed(faint, &[0.0; 6], &as_reference);
        assert_eq!(kept.triangles(), [0, 0, 0, 1, 2], "the reference removes none of such a triangle");
    }

    #[test]
    fn oversized_gaussians_go_after_the_first_reset() {
        let units = [0.2, 0.05, 0.05, 0.05];
        let large = bound(&[0, 0, 1]);
        assert_eq!(changed(large.clone(), &[0.0; 3], &scene(&units)).bound.len(), 3);
        let pruning = DensityScene { prune_large: true, ..scene(&units) };
        let Changed { bound: kept, .. } = changed(large, &[0.0; 3], &pruning);
        assert_eq!(kept.triangles(), [0, 1], "one of the oversized ones stays for its triangle");
    }

    #[test]
    fn changes_come_at_their_iterations() {
        let control = DensityControl::default();
        let due: Vec<u64> = (0..=16_000).filter(|&iteration| control.is_due(iteration)).collect();
        assert_eq!(due, [12_000, 14_000, 16_000]);
        assert!(!control.is_due(600_000) && control.is_due(598_000));
        assert!(control.resets(60_000, false) && !control.resets(600_000, true));
        assert!(control.resets(10_000, true) && !control.resets(10_000, false));
        let never = DensityControl { interval: 0, reset_interval: 0, ..control };
        assert!(!never.is_due(12_000) && !never.resets(60_000, false));
        assert_eq!(DensityControl { strategy: Strategy::AbsGs, ..control }.threshold(), 8e-4);
    }
}
