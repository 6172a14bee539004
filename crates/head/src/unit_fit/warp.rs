//! A smooth map between heads from corresponding points.

use glam::{DMat3, DVec3};

use srflow_core::dense;

/// Added to the diagonal of the kernel's matrix, whose entries there are 1: how closely points are met.
const SMOOTHING: f64 = 1e-3;

/// Weight of equal scaling in all directions against the points, in the affine part.
const STIFFNESS: f64 = 1e-2;

/// A map of space that takes points to points: an affine map, and around the points what it leaves, interpolated with Matern's kernel
/// (1 + r) exp(-r). Far from the points the map is affine.
pub(super) struct Warp {
    linear: DMat3,
    from: DVec3,
    to: DVec3,
    centres: Vec<DVec3>,
    weights: Vec<DVec3>,
    reach: f64,
}

impl Warp {
    /// The map that takes the points of `from` to those of `to`, both in metres, with a kernel of width `reach`, metres; `None` if the
    /// points are not finite or all the same.
    pub(super) fn new(from: &[DVec3], to: &[DVec3], reach: f64) -> Option<Self> {
        let count = from.len().min(to.len());
        let mean = |points: &[DVec3]| points[..count].iter().sum::<DVec3>() / count as f64;
        let (from_mean, to_mean) = (mean(from), mean(to));
        let mut spread = DMat3::ZERO;
        let mut cross = DMat3::ZERO;
        for (from, to) in from.iter().zip(to) {
            let (x, y) = (*from - from_mean, *to - to_mean);
            spread += DMat3::from_cols(x * x.x, x * x.y, x * x.z);
            cross += DMat3::from_cols(y * x.x, y * x.y, y * x.z);
        }
        let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
        let scale = trace(&cross) / trace(&spread);
        let stiff = DMat3::IDENTITY * (STIFFNESS * trace(&spread));
        let linear = (cross + stiff * scale) * (spread + stiff).inverse();

        let mut kernel = vec![0.0; count * count];
        for (i, a) in from[..count].iter().enumerate() {
            for (j, b) in from[..count].iter().enumerate() {
                kernel[i * count + j] = matern(a.distance(*b) / reach);
            }
            kernel[i * count + i] += SMOOTHING;
        }
        let inverse = dense::inverse(kernel, count)?;
        let left: Vec<DVec3> =
            from.iter().zip(to).map(|(from, to)| *to - to_mean - linear * (*from - from_mean)).collect();
        let weights = inverse
            .chunks_exact(count)
            .map(|row| row.iter().zip(&left).fold(DVec3::ZERO, |sum, (weight, left)| sum + *left * *weight))
            .collect();
        let warp =
            Self { linear, from: from_mean, to: to_mean, centres: from[..count].to_vec(), weights, reach };
        warp.at(from_mean).is_finite().then_some(warp)
    }

    /// Where `p` goes.
    pub(super) fn at(&self, p: DVec3) -> DVec3 {
        let affine = self.to + self.linear * (p - self.from);
        let kernels = self.centres.iter().zip(&self.weights);
        kernels.fold(affine, |sum, (centre, weight)| sum + *weight * matern(p.distance(*centre) / self.reach))
    }
}

fn matern(r: f64) -> f64 {
    (1.0 + r) * libm::exp(-r)
}
