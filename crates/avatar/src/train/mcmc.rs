//! 3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand et al. 2024; gsplat, `strategy/mcmc.py`): transparent Gaussians
//! move to opaque ones, which are drawn by their opacity; all together look as before the move. In between, Gaussians wander, the
//! farther the more transparent they are, and all are pressed to be few, transparent and small.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use srflow_core::random::Stream;
use srflow_splat::Gaussians;

use super::density::most_opaque;
use super::{DensityChange, GaussianAdam};
use crate::BoundGaussians;

/// The settings of [`Strategy::Mcmc`](super::Strategy::Mcmc) beyond those of [`DensityControl`](super::DensityControl). Scales and
/// positions are in units of the triangles, in which the Gaussians of an avatar are all of about the same size; the weights of
/// the paper belong to scenes of about one world unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mcmc {
    /// Number of Gaussians at which no more are added.
    pub most_gaussians: usize,
    /// Share by which their number grows with each change.
    pub growth: f32,
    /// Opacity of all Gaussians at the start.
    pub initial_opacity: f32,
    /// Length of a random step of a transparent Gaussian with the first rate of positions, over its variance along the step.
    pub noise: f32,
    /// Weight of the mean opacity in the loss.
    pub opacity_weight: f32,
    /// Weight of the mean scale in the loss.
    pub scale_weight: f32,
}

impl Default for Mcmc {
    fn default() -> Self {
        Self {
            most_gaussians: 200_000,
            growth: 0.05,
            initial_opacity: 0.5,
            noise: 1.0,
            opacity_weight: 0.01,
            scale_weight: 0.01,
        }
    }
}

impl Mcmc {
    /// Adds the gradients of [`Mcmc::opacity_weight`] times the mean opacity and [`Mcmc::scale_weight`] times the mean of all scales.
    pub(super) fn backward(&self, local: &Gaussians, opacities: &mut [f32], scales: &mut [Vec3]) {
        let n = local.len().max(1) as f32;
        opacities.iter_mut().for_each(|slope| *slope += self.opacity_weight / n);
        scales.iter_mut().for_each(|slope| *slope += Vec3::splat(self.scale_weight / (3.0 * n)));
    }
}

/// Replaces the Gaussians whose opacity is at most `least_opacity`, except for the last of a triangle, by copies of others, and adds
/// more copies. A copy is on the triangle of its parent; opacity and scale of parent and copies are those of [`relocated`], and the
/// moments of copies start at zero.
///
/// Panics when a Gaussian is on a triangle beyond number `triangles`.
pub fn relocate(
    bound: &mut BoundGaussians,
    adam: &mut GaussianAdam,
    settings: &Mcmc,
    least_opacity: f32,
    triangles: usize,
    stream: &mut Stream,
) -> DensityChange {
    let living = living(bound, least_opacity, triangles);
    let before = bound.len();
    let grown = (before as f64 * (1.0 + f64::from(settings.growth))) as usize;
    // Beyond the limit from the start, their number stays.
    let wanted = grown.min(settings.most_gaussians).max(before);

    // Sums of opacities, to draw by.
    let mut total = 0.0;
    let sums: Vec<f64> = living
        .iter()
        .map(|&number| {
            total += f64::from(bound.local().opacities[number as usize]);
            total
        })
        .collect();
    let mut copies = vec![0_u32; living.len()];
    for _ in living.len()..wanted {
        let at = f64::from(stream.unit()) * total;
        copies[sums.partition_point(|&sum| sum <= at).min(living.len() - 1)] += 1;
    }

    let mut parents = living;
    let survivors = parents.len();
    // The number in the new order of the parent of each copy.
    let places: Vec<usize> =
        copies.iter().enumerate().flat_map(|(place, &count)| (0..count).map(move |_| place)).collect();
    parents.extend(places.iter().map(|&place| parents[place]).collect::<Vec<_>>());
    bound.inherit(adam, &parents, survivors);
    let local = bound.local_mut();
    let shared: Vec<Option<(f32, Vec3)>> = copies
        .iter()
        .enumerate()
        .map(|(place, &count)| {
            let (opacity, factor) = relocated(f64::from(local.opacities[place]), count + 1);
            (count > 0).then(|| ((opacity as f32).max(least_opacity), local.scales[place] * factor as f32))
        })
        .collect();
    for (at, place) in (0..survivors).chain(places).enumerate() {
        if let Some((opacity, scale)) = shared[place] {
            adam.set_opacity(local, at, opacity);
            adam.set_scale(local, at, scale);
        }
    }
    DensityChange { cloned: wanted - survivors, split: 0, pruned: before - survivors }
}

/// Numbers of the Gaussians that stay: those of more than the least opacity, and the most opaque of each triangle that has no
/// such.
fn living(bound: &BoundGaussians, least_opacity: f32, triangles: usize) -> Vec<u32> {
    let opacities = &bound.local().opacities;
    let triangle = |number: usize| bound.triangles()[number] as usize;
    let all = opacities.iter().enumerate().map(|(number, &opacity)| (number, triangle(number), opacity));
    let best = most_opaque(all, triangles);
    let lives = |&number: &usize| opacities[number] > least_opacity || best[triangle(number)] == Some(number);
    (0..bound.len()).filter(lives).map(|number| number as u32).collect()
}

/// Moves the positions by normally distributed steps of covariance `(strength share(o))^2 Sigma^2`, with the covariance `Sigma` of each
/// Gaussian and `share(o) = 1 / (1 + exp(100 (o - least_opacity)))` (equation 8 of the paper). Shares below 1e-4 count as zero.
pub fn wander(local: &mut Gaussians, strength: f32, least_opacity: f32, stream: &mut Stream) {
    const LEAST_SHARE: f32 = 1e-4;
    for (i, &opacity) in local.opacities.iter().enumerate() {
        let share = 1.0 / (1.0 + libm::expf(100.0 * (opacity - least_opacity)));
        if share < LEAST_SHARE {
            continue;
        }
        let sample = Vec3::new(stream.normal(), stream.normal(), stream.normal());
        let rotation = local.rotations[i].normalize();
        let variances = local.scales[i] * local.scales[i];
        local.positions[i] += rotation * (variances * (rotation.inverse() * sample)) * (strength * share);
    }
}

/// Number of Gaussians at one place up to which they are made to look like one.
const MOST_SHARING: u32 = 51;

/// Opacity and factor of the scale of each of `count` Gaussians at the same place that look like one of `opacity` (equation 9 of the
/// paper): `o' = 1 - (1 - o)^(1/n)`, `s' = s o / sum_i sum_k C(i - 1, k) (-1)^k o'^(k + 1) / sqrt(k + 1)`, with `i` from 1 to `n` and
/// `k` from 0 to `i - 1`. More than 51 count as 51, as in gsplat: the sum alternates.
fn relocated(opacity: f64, count: u32) -> (f64, f64) {
    let count = count.clamp(1, MOST_SHARING);
    let each = 1.0 - libm::pow(1.0 - opacity, 1.0 / f64::from(count));
    let mut sum = 0.0;
    for i in 1..=count {
        // C(i - 1, k) (-o')^k o', from the one before.
        let mut term = each;
        for k in 0..i {
            sum += term / libm::sqrt(f64::from(k + 1));
            term *= -each * f64::from(i - 1 - k) / f64::from(k + 1);
        }
    }
    (each, if sum > 0.0 { opacity / sum } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use srflow_core::random::Key;

    use super::*;

    /// Gaussians of these opacities on these triangles.
    fn bound(opacities: &[f32], triangles: &[u32]) -> BoundGaussians {
        let n = opacities.len();
        let local = Gaussians {
            positions: (0..n).map(|i| Vec3::X * i as f32).collect(),
            scales: vec![Vec3::new(1.0, 0.5, 0.1); n],
            rotations: vec![Quat::from_rotation_z(0.4); n],
            opacities: opacities.to_vec(),
            sh_degree: 0,
            sh: (0..n).map(|i| [i as f32; 3]).collect(),
            antialiased: false,
        };
        BoundGaussians::new(local, triangles.to_vec(), 3).unwrap()
    }

    fn change(bound: &mut BoundGaussians, settings: &Mcmc) -> DensityChange {
        let mut adam = GaussianAdam::new(bound.local());
        relocate(bound, &mut adam, settings, 0.005, 3, &mut Key::new(2).stream("mcmc"))
    }

    #[test]
    fn transparent_gaussians_move_to_opaque_ones_but_never_the_last_of_a_triangle() {
        let opacities = [0.9, 0.001, 0.004, 0.003, 0.002, 0.001];
        let mut found = bound(&opacities, &[0, 0, 0, 1, 1, 2]);
        let settings = Mcmc { growth: 0.0, ..Mcmc::default() };
        let moved = change(&mut found, &settings);
        assert_eq!(moved, DensityChange { cloned: 3, split: 0, pruned: 3 });
        // The opaque one of triangle 0, the better one of triangle 1, the only one of triangle 2, then copies of the opaque one.
        assert_eq!(found.triangles(), [0, 1, 2, 0, 0, 0]);
        let local = found.local();
        let colors: Vec<f32> = local.sh.iter().map(|color| color[0]).collect();
        assert_eq!(colors, [0.0, 3.0, 5.0, 0.0, 0.0, 0.0]);
        let together = 1.0 - (1.0 - local.opacities[0]).powi(4);
        assert!((together - 0.9).abs() < 1e-5, "{together}");
        assert!(local.opacities[3..].iter().all(|&opacity| opacity == local.opacities[0]));
        assert!(local.scales[0] == local.scales[4] && local.scales[0].x < 1.0);
        assert_eq!((local.opacities[1], local.scales[1]), (0.003, Vec3::new(1.0, 0.5, 0.1)), "not drawn");
    }

    #[test]
    fn their_number_grows_up_to_the_limit_and_copies_are_drawn_by_opacity() {
        let mut opacities = vec![0.1; 1000];
        opacities[..500].fill(0.9);
        let settings = Mcmc { growth: 0.5, most_gaussians: 1400, ..Mcmc::default() };
        let mut found = bound(&opacities, &vec![0; 1000]);
        assert_eq!(change(&mut found, &settings), DensityChange { cloned: 400, split: 0, pruned: 0 });
        let of_opaque = found.local().sh[1000..].iter().filter(|color| color[0] < 500.0).count();
        // Expected 360, standard deviation 6.
        assert!((336..384).contains(&of_opaque), "{of_opaque}");
        assert_eq!(change(&mut found, &settings), DensityChange::default());
        let few = Mcmc { most_gaussians: 7, ..settings };
        assert_eq!(change(&mut found, &few), DensityChange::default(), "none is removed for the limit alone");
    }

    #[test]
    fn transparent_gaussians_wander_along_their_long_axes() {
        let n = 4000;
        let mut local = bound(&vec![0.0; n], &vec![0; n]).local().clone();
        local.opacities[n / 2..].fill(0.3);
        let before = local.clone();
        wander(&mut local, 0.5, 0.005, &mut Key::new(5).stream("wander"));
        assert_eq!(local.positions[n / 2..], before.positions[n / 2..]);
        let share = 1.0 / (1.0 + (-0.5_f32).exp());
        for (axis, scale) in [(Vec3::X, 1.0_f32), (Vec3::Y, 0.5), (Vec3::Z, 0.1)] {
            let axis = Quat::from_rotation_z(0.4) * axis;
            let steps = (0..n / 2).map(|i| (local.positions[i] - before.positions[i]).dot(axis));
            let rms = (steps.map(|step| f64::from(step * step)).sum::<f64>() / (n / 2) as f64).sqrt();
            let expected = f64::from(0.5 * share * scale * scale);
            // Positions are up to 4000 long: steps are rounded.
            assert!((rms / expected - 1.0).abs() < 0.06, "{rms}, {expected}");
        }
        assert_eq!(Gaussians { positions: before.positions.clone(), ..local }, before);
    }

    #[test]
    fn one_gaussian_stays_as_it_is() {
        let (opacity, scale) = relocated(0.7, 1);
        assert!((opacity - 0.7).abs() < 1e-12 && (scale - 1.0).abs() < 1e-12);
    }

    #[test]
    fn copies_together_have_the_opacity_and_the_mass_of_the_whole() {
        for (opacity, count) in [(0.9, 2), (0.3, 5), (0.05, 51)] {
            let (each, scale) = relocated(opacity, count);
            let together = 1.0 - (1.0 - each).powi(count as i32);
            assert!((together - opacity).abs() < 1e-12);
            // Integrals along a line through the centre: of what the copies show, and of the one before.
            let step = 1e-3;
            let integral = |shown: &dyn Fn(f64) -> f64| {
                (-8000..8000).map(|i| shown(f64::from(i) * step) * step).sum::<f64>()
            };
            let copies = integral(&|x| {
                1.0 - (1.0 - each * (-0.5 * (x / scale) * (x / scale)).exp()).powi(count as i32)
            });
            let one = integral(&|x| opacity * (-0.5 * x * x).exp());
            assert!((copies / one - 1.0).abs() < 1e-6, "{opacity}, {count}: {copies}, {one}");
        }
    }
}
