//! Small marks on the skin: freckles, moles and pores.

use glam::Vec3;

use super::Dressing;
use super::Splat;
use super::complexion::Complexion;
use super::skin::flat;
use super::surface::{Buckets, SurfacePoint};
use crate::Look;

const MM: f32 = 1e-3;

/// A freckle or a mole.
struct Speck {
    point: SurfacePoint,
    /// Standard deviation, metres.
    sigma: f32,
    /// Height above the skin, metres.
    height: f32,
    color: Vec3,
    /// Factor by which each channel of the surrounding skin's colour is reduced.
    tint: Vec3,
    opacity: f32,
}

/// All freckles and moles of a person. Each is a separate Gaussian and also darkens the skin's Gaussians below: otherwise,
/// at grazing angles, nearer skin Gaussians would cover half of it and leave a streak.
pub(super) struct Specks {
    specks: Vec<Speck>,
    near: Buckets,
}

impl Specks {
    /// The specks on the triangles `face`.
    pub fn new(dressing: &Dressing, complexion: &Complexion, face: &[u32]) -> Self {
        let mut specks = moles(dressing, complexion, face);
        if dressing.appearance.freckles > 0.0 {
            specks.extend(freckles(dressing, complexion, face));
        }
        let mut near = Buckets::new(2.5 * MM * dressing.surface.size);
        for (number, speck) in specks.iter().enumerate() {
            near.insert(speck.point.position, number as u32);
        }
        Self { specks, near }
    }

    /// Factor for each channel of the skin's colour at `p`.
    pub fn tint(&self, p: Vec3) -> Vec3 {
        let here = self.near.near(p).map(|number| {
            let speck = &self.specks[number as usize];
            let distance = speck.point.position.distance_squared(p) / (speck.sigma * speck.sigma);
            Vec3::ONE.lerp(speck.tint, speck.opacity * libm::expf(-0.5 * distance))
        });
        here.product()
    }

    pub fn splats(&self) -> impl Iterator<Item = (u32, Splat)> {
        self.specks.iter().map(|speck| {
            let position = speck.point.position + speck.point.normal * speck.height;
            let (sigma, opacity) = (speck.sigma, speck.opacity);
            let splat = flat(position, speck.point.normal, sigma, 0.5 * sigma, speck.color, opacity);
            (speck.point.triangle, splat)
        })
    }
}

fn freckles(dressing: &Dressing, complexion: &Complexion, face: &[u32]) -> Vec<Speck> {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("freckles");
    let mut freckles = Vec::new();
    for point in surface.scatter(face, |_| 2.3 * MM * size, &mut stream) {
        let likely = complexion.sun(point.position) * dressing.appearance.freckles;
        if stream.unit() > likely || complexion.lip(&point) > -2.0 * MM {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let tint = Vec3::new(0.80, 0.66, 0.57);
        let sigma = stream.uniform(0.3, 0.75) * MM * size;
        let opacity = stream.uniform(0.16, 0.42);
        freckles.push(Speck { point, sigma, height: 0.14 * MM * size, color: lit * tint, tint, opacity });
    }
    freckles
}

fn moles(dressing: &Dressing, complexion: &Complexion, face: &[u32]) -> Vec<Speck> {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("moles");
    let rare = if dressing.look == Look::First { 0.07 } else { 0.04 };
    let mut moles = Vec::new();
    for point in surface.scatter(face, |_| 16.0 * MM * size, &mut stream) {
        if stream.unit() > rare || complexion.lip(&point) > -3.0 * MM {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let sigma = stream.uniform(0.35, 0.8) * MM * size;
        let tint = Vec3::new(0.48, 0.36, 0.31);
        moles.push(Speck { point, sigma, height: 0.25 * MM * size, color: lit * tint, tint, opacity: 0.7 });
    }
    moles
}

/// Pores on the triangles `face`, nearly round, to avoid streaks where the skin turns away.
pub(super) fn pores(dressing: &Dressing, complexion: &Complexion, face: &[u32]) -> Vec<(u32, Splat)> {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("pores");
    let mut pores = Vec::new();
    for point in surface.scatter(face, |_| 1.3 * MM * size, &mut stream) {
        if stream.unit() > complexion.pores(point.position) {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, true);
        let color = lit * Vec3::new(0.80, 0.72, 0.70);
        let sigma = stream.uniform(0.11, 0.17) * MM * size;
        let position = point.position + point.normal * (0.14 * MM * size);
        pores.push((point.triangle, flat(position, point.normal, sigma, 0.8 * sigma, color, 0.34)));
    }
    pores
}
