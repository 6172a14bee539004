//! Lighting baked into the colours: a photographer's studio, computed once on the head at rest.

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use super::occlusion::Occluder;
use super::surface::Surface;
use crate::srgb::srgb_from_linear;
use crate::{Look, Region};

/// Direction of the weak fill light on the other side.
const FILL_DIRECTION: Vec3 = Vec3::new(0.76, 0.12, 0.64);
const FILL_RADIUS: f32 = 0.5;

/// The lights of a studio.
#[derive(Debug)]
pub(super) struct Studio {
    /// Direction of the large soft box, at the viewer's upper left.
    key_direction: Vec3,
    /// Tangent of its half angle.
    key_radius: f32,
    key: Vec3,
    fill: Vec3,
    /// Ambient light from below and from above.
    ground: Vec3,
    sky: Vec3,
}

/// So much ambient light that it hides the relief of a face; hair needs it.
static EVEN: Studio = Studio {
    key_direction: Vec3::new(-0.50, 0.53, 0.69),
    key_radius: 0.32,
    key: Vec3::new(0.80, 0.765, 0.72),
    fill: Vec3::new(0.21, 0.225, 0.245),
    ground: Vec3::new(0.19, 0.175, 0.165),
    sky: Vec3::new(0.40, 0.41, 0.43),
};

static CONTRASTY: Studio = Studio {
    key_direction: Vec3::new(-0.48, 0.68, 0.64),
    key_radius: 0.2,
    key: Vec3::new(0.93, 0.885, 0.82),
    fill: Vec3::new(0.19, 0.175, 0.165),
    ground: Vec3::new(0.20, 0.165, 0.15),
    sky: Vec3::new(0.285, 0.28, 0.28),
};

impl Studio {
    /// The one in which skin, eyes and mouths of a look are.
    pub fn of(look: Look) -> &'static Self {
        if look == Look::First { &EVEN } else { &CONTRASTY }
    }

    /// The colour, sRGB in `0..=1`, of a material with this normal and exposure, seen from the front.
    pub fn shade(&'static self, material: &Material, normal: Vec3, exposure: &Exposure) -> Vec3 {
        let (key, fill) = (self.key_direction.normalize(), FILL_DIRECTION.normalize());
        let diffuse = Lit::of(self, exposure).diffuse(normal, material.wrap);
        let sheen = material.sheen
            * (exposure.key * gloss(normal, key, material.gloss)
                + 0.35 * exposure.fill * gloss(normal, fill, material.gloss));
        tone_mapped(material.albedo * diffuse * 1.12 + Vec3::splat(sheen))
    }
}

/// The lights that hair uses.
pub(super) struct HairLights {
    pub ambient: Vec3,
    pub key: Vec3,
    pub key_color: Vec3,
    pub fill: Vec3,
    pub fill_color: Vec3,
}

pub(super) static HAIR_LIGHTS: HairLights = HairLights {
    ambient: EVEN.sky,
    key: EVEN.key_direction,
    key_color: EVEN.key,
    fill: FILL_DIRECTION,
    fill_color: EVEN.fill,
};

const AMBIENT_RAYS: usize = 40;
const KEY_RAYS: usize = 14;
const FILL_RAYS: usize = 8;

/// Exposure of a point to each light.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Exposure {
    /// Visible part of the sky, weighted by the cosine, `0..=1`.
    pub sky: f32,
    /// Visible part of the soft box.
    pub key: f32,
    /// Visible part of the fill light.
    pub fill: f32,
}

impl std::ops::Mul<f32> for Exposure {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        Self { sky: self.sky * s, key: self.key * s, fill: self.fill * s }
    }
}

impl Exposure {
    /// Light by light.
    pub fn times(self, o: Self) -> Self {
        Self { sky: self.sky * o.sky, key: self.key * o.key, fill: self.fill * o.fill }
    }

    /// With each between 0 and 1.
    pub fn clamped(self) -> Self {
        Self { sky: self.sky.clamp(0.0, 1.0), key: self.key.clamp(0.0, 1.0), fill: self.fill.clamp(0.0, 1.0) }
    }
}

impl std::ops::Add for Exposure {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self { sky: self.sky + o.sky, key: self.key + o.key, fill: self.fill + o.fill }
    }
}

/// Optical properties of a material.
#[derive(Debug, Clone, Copy)]
pub(super) struct Material {
    /// Linear sRGB reflectance.
    pub albedo: Vec3,
    /// How far light wraps around the shadow edge, by channel: subsurface scattering.
    pub wrap: Vec3,
    /// Strength and exponent of the specular reflection.
    pub sheen: f32,
    pub gloss: f32,
}

impl Material {
    pub fn matt(albedo: Vec3) -> Self {
        Self { albedo, wrap: Vec3::ZERO, sheen: 0.0, gloss: 1.0 }
    }
}

/// Regions that light falls on and that keep it from others.
pub(super) const OPAQUE: [Region; 8] = [
    Region::Skin,
    Region::Scalp,
    Region::Lips,
    Region::Brow,
    Region::LidMargin,
    Region::InnerLid,
    Region::Neck,
    Region::Eyeball,
];

/// The exposure, without smoothing, of the `wanted` vertices of a head whose vertices are `vertices`; zero for the others and those that are
/// not lit.
pub(super) fn bake(
    studio: &Studio,
    surface: &Surface,
    vertices: &[Vec3],
    normals: &[Vec3],
    wanted: impl Fn(usize) -> bool + Sync,
) -> Vec<Exposure> {
    let corners = |t: &u32| surface.model.triangles[*t as usize].map(|v| vertices[v as usize]);
    let occluder = Occluder::new(surface.triangles_of(&OPAQUE).iter().map(corners));
    let lit = surface.corners_of(&OPAQUE);
    let rays = Rays::new(studio);
    (0..vertices.len())
        .into_par_iter()
        .map(|v| match lit[v] && wanted(v) {
            true => rays.past(&occluder, vertices[v], normals[v], surface.size),
            false => Exposure::default(),
        })
        .collect()
}

/// The part of the light that reaches each vertex through `hair`, which lets so much of it through from a point in a direction.
pub(super) fn through_hair(
    studio: &Studio,
    surface: &Surface,
    hair: impl Fn(Vec3, Vec3) -> f32 + Sync,
    wanted: impl Fn(usize) -> bool + Sync,
) -> Vec<Exposure> {
    let rays = Rays::new(studio);
    let at = |v: usize| {
        rays.exposure(surface.normals[v], |directions| {
            let count = directions.len() as f32;
            directions.map(|direction| hair(surface.vertices[v], direction)).sum::<f32>() / count
        })
    };
    let clear = Exposure { sky: 1.0, key: 1.0, fill: 1.0 };
    let mut light: Vec<Exposure> =
        (0..surface.vertices.len()).into_par_iter().map(|v| if wanted(v) { at(v) } else { clear }).collect();
    surface.smooth(&mut light);
    light
}

/// Ray directions, the same for every vertex so that neighbours agree.
struct Rays {
    /// Over the hemisphere around +z, cosine-weighted.
    sky: Vec<Vec3>,
    key: Vec<Vec3>,
    fill: Vec<Vec3>,
}

impl Rays {
    fn new(studio: &Studio) -> Self {
        let sky = spiral(AMBIENT_RAYS).map(|[x, y, r2]| Vec3::new(x, y, (1.0 - r2).max(0.0).sqrt()));
        let disc = |toward: Vec3, radius: f32, count| {
            let axis = toward.normalize();
            let (right, up) = axis.any_orthonormal_pair();
            spiral(count).map(|[x, y, _]| (axis + (right * x + up * y) * radius).normalize()).collect()
        };
        Self {
            sky: sky.collect(),
            key: disc(studio.key_direction, studio.key_radius, KEY_RAYS),
            fill: disc(FILL_DIRECTION, FILL_RADIUS, FILL_RAYS),
        }
    }

    /// The exposure of a point with this normal past an occluder.
    fn past(&self, occluder: &Occluder, p: Vec3, normal: Vec3, size: f32) -> Exposure {
        // Offset from the surface, so that a coarse mesh does not shade itself.
        let origin = p + normal * (0.0007 * size);
        let reach = 0.18 * size;
        self.exposure(normal, |directions| {
            let count = directions.len();
            (count - occluder.blocked(origin, directions, reach) as usize) as f32 / count as f32
        })
    }

    /// The exposure of a point with this normal, where `seen` is the part of the rays in some directions that reach it.
    fn exposure(
        &self,
        normal: Vec3,
        seen: impl Fn(&mut dyn ExactSizeIterator<Item = Vec3>) -> f32,
    ) -> Exposure {
        let (right, up) = normal.any_orthonormal_pair();
        Exposure {
            sky: seen(&mut self.sky.iter().map(|d| right * d.x + up * d.y + normal * d.z)),
            key: seen(&mut self.key.iter().copied()),
            fill: seen(&mut self.fill.iter().copied()),
        }
    }
}

/// Points evenly distributed on the unit disc (Vogel's sunflower), each with its squared radius.
fn spiral(count: usize) -> impl Iterator<Item = [f32; 3]> {
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    (0..count).map(move |i| {
        let r2 = (i as f32 + 0.5) / count as f32;
        let angle = i as f32 * GOLDEN_ANGLE;
        [libm::cosf(angle) * r2.sqrt(), libm::sinf(angle) * r2.sqrt(), r2]
    })
}

/// Light that reaches a point from each direction, after shadows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lit {
    studio: &'static Studio,
    sky: Vec3,
    key: Vec3,
    fill: Vec3,
    exposure: Exposure,
}

/// Skin: how far light wraps around, by channel, and the strength of its reflection; its exponent is 16.
pub(super) const SKIN_WRAP: Vec3 = Vec3::new(0.36, 0.16, 0.09);
const SKIN_SHEEN: f32 = 0.05;

impl Lit {
    pub fn of(studio: &'static Studio, exposure: &Exposure) -> Self {
        let sky = exposure.sky;
        // The little light that reaches a crease was reflected by skin before, which absorbs blue.
        let shadow = |seen: f32| Vec3::new(libm::powf(seen, 0.8), seen, libm::powf(seen, 1.08));
        Self {
            studio,
            sky: Vec3::new(libm::powf(sky, 0.75), sky, libm::powf(sky, 1.15)),
            key: studio.key * shadow(exposure.key),
            fill: studio.fill * shadow(exposure.fill),
            exposure: *exposure,
        }
    }

    /// Between the corners of a triangle.
    pub fn mixed(corners: [Self; 3], weights: Vec3) -> Self {
        let mut sum = corners[0].times(weights.x);
        for (corner, weight) in corners[1..].iter().zip([weights.y, weights.z]) {
            let part = corner.times(weight);
            sum = Self {
                studio: sum.studio,
                sky: sum.sky + part.sky,
                key: sum.key + part.key,
                fill: sum.fill + part.fill,
                exposure: sum.exposure + part.exposure,
            };
        }
        sum
    }

    fn times(self, s: f32) -> Self {
        Self {
            sky: self.sky * s,
            key: self.key * s,
            fill: self.fill * s,
            exposure: self.exposure * s,
            ..self
        }
    }

    /// The part that a surface with this normal scatters, per reflectance.
    fn diffuse(&self, normal: Vec3, wrap: Vec3) -> Vec3 {
        let (key, fill) = (self.studio.key_direction.normalize(), FILL_DIRECTION.normalize());
        self.studio.ground.lerp(self.studio.sky, normal.y * 0.5 + 0.5) * self.sky
            + self.key * lambert(normal.dot(key), wrap)
            + self.fill * lambert(normal.dot(fill), wrap)
    }

    /// Linear light from skin of this reflectance and normal, seen from the front.
    pub fn on(&self, normal: Vec3, albedo: Vec3) -> Vec3 {
        let (key, fill) = (self.studio.key_direction.normalize(), FILL_DIRECTION.normalize());
        let gloss = |light: Vec3| {
            let cosine = normal.dot((light + Vec3::Z).normalize()).max(0.0);
            [(); 4].iter().fold(cosine, |power, ()| power * power)
        };
        let sheen = SKIN_SHEEN * (self.exposure.key * gloss(key) + 0.35 * self.exposure.fill * gloss(fill));
        albedo * self.diffuse(normal, SKIN_WRAP) * 1.12 + Vec3::splat(sheen.max(1e-3))
    }
}

/// The lights, and how skin reflects them, as [`Lit::on`] computes with them.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SkinLight {
    key: [f32; 3],
    key_color: [f32; 3],
    fill: [f32; 3],
    fill_color: [f32; 3],
    ground_color: [f32; 3],
    sky_color: [f32; 3],
    wrap: [f32; 3],
    sheen: f32,
}

impl SkinLight {
    pub fn new(studio: &Studio) -> Self {
        Self {
            key: studio.key_direction.normalize().to_array(),
            key_color: studio.key.to_array(),
            fill: FILL_DIRECTION.normalize().to_array(),
            fill_color: studio.fill.to_array(),
            ground_color: studio.ground.to_array(),
            sky_color: studio.sky.to_array(),
            wrap: SKIN_WRAP.to_array(),
            sheen: SKIN_SHEEN,
        }
    }
}

fn lambert(cosine: f32, wrap: Vec3) -> Vec3 {
    ((Vec3::splat(cosine) + wrap) / (Vec3::ONE + wrap)).max(Vec3::ZERO)
}

fn gloss(normal: Vec3, light: Vec3, exponent: f32) -> f32 {
    let half = (light + Vec3::Z).normalize();
    libm::powf(normal.dot(half).max(0.0), exponent)
}

/// Linear light to sRGB, with a shoulder that compresses highlights.
pub(super) fn tone_mapped(linear: Vec3) -> Vec3 {
    let channel = |x: f32| {
        let x = x.max(0.0);
        if x > 0.65 { 0.65 + 0.35 * (1.0 - libm::expf(-(x - 0.65) / 0.35)) } else { x }
    };
    srgb_from_linear(Vec3::new(channel(linear.x), channel(linear.y), channel(linear.z)))
}
