//! Lamps that shade a head beside the light that its Gaussians already carry. Heads cast no shadows on themselves.

use glam::Vec3;
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::random::{Key, Stream};
use srflow_head::{Look, vertex_normals};
use srflow_splat::{Gaussians, SH_0, scale_colour};

use crate::recording::coded;

/// Least and greatest factor of light on any surface.
const LIGHT: (f32, f32) = (0.2, 2.5);

/// The lamps of one scene, which stand still in the world.
#[derive(Debug, Clone)]
pub(super) struct Lamps {
    ambient: Vec3,
    lamps: Vec<Lamp>,
    look: Look,
}

#[derive(Debug, Clone)]
struct Lamp {
    /// From the head.
    direction: Vec3,
    /// Red, green and blue on a surface that faces it.
    light: Vec3,
}

impl Lamps {
    /// One to three lamps and ambient light, which together leave a head that is lit from all sides of its front as it was on
    /// average. `strength`, 0 to 1, is the share of the light that comes from lamps at most.
    pub fn random(key: Key, strength: f32, look: Look) -> Self {
        let mut stream = key.stream("lamps");
        let directed = strength * stream.uniform(0.3, 1.0);
        let count = 1 + stream.below(3);
        let mut lamps = Self { ambient: Vec3::splat(1.0 - directed), lamps: Vec::new(), look };
        for number in 0..count {
            // Each is half as strong as the one before, and may stand farther to the side and behind.
            let light = directed * libm::exp2f(-(number as f32)) * tint(&mut stream);
            let azimuth = stream.uniform(-1.0, 1.0) * (70.0 + 45.0 * number as f32);
            let elevation = stream.uniform(-15.0, 65.0);
            lamps.lamps.push(Lamp { direction: direction(azimuth, elevation), light });
        }
        let front = [(0.0, 0.0), (-50.0, 0.0), (50.0, 0.0), (0.0, 40.0), (0.0, -40.0)];
        let mean: Vec3 =
            front.iter().map(|&(azimuth, elevation)| lamps.at(direction(azimuth, elevation))).sum::<Vec3>()
                / 5.0;
        // The lamps' tints stay; the mean of the channels is 1.
        let scale = 3.0 / mean.element_sum();
        lamps.ambient *= scale;
        lamps.lamps.iter_mut().for_each(|lamp| lamp.light *= scale);
        lamps
    }

    /// Light on a surface with this normal, relative to before.
    fn at(&self, normal: Vec3) -> Vec3 {
        // Lamps are large: their light reaches a little beyond the surfaces that face them.
        const WRAP: f32 = 0.25;
        let of = |lamp: &Lamp| lamp.light * ((normal.dot(lamp.direction) + WRAP) / (1.0 + WRAP)).max(0.0);
        self.ambient + self.lamps.iter().map(of).sum::<Vec3>()
    }

    /// Shades the Gaussians of a posed head.
    pub fn shade(&self, avatar: &Avatar, head: &PosedHead, gaussians: &mut Gaussians) {
        let lights: Vec<[f32; 3]> = normals(avatar, head)
            .into_iter()
            .map(|normal| self.at(normal).to_array().map(|light| coded(light.clamp(LIGHT.0, LIGHT.1))))
            .map(|light| if self.look == Look::First { light } else { through_skin(light) })
            .collect();
        let coefficients = gaussians.sh_len();
        let triangles = avatar.bound().triangles();
        for (sh, &triangle) in gaussians.sh.chunks_mut(coefficients).zip(triangles) {
            let Some(&light) = lights.get(triangle as usize) else { continue };
            let light = match self.look {
                Look::First => light,
                Look::Second => exposed(sh[0].map(|c| 0.5 + SH_0 as f32 * c), light),
            };
            scale_colour(sh, light, 0.5);
        }
    }
}

/// Coded colours above the first are compressed, and stay below the second, as by a camera that exposes for the face.
const SHOULDER: [f32; 2] = [0.66, 0.9];

/// Shadows on skin are redder than their light: what reaches them was in the skin before.
fn through_skin(light: [f32; 3]) -> [f32; 3] {
    const WARMTH: [f32; 3] = [0.82, 1.0, 1.06];
    [0, 1, 2].map(|c| if light[c] < 1.0 { libm::powf(light[c], WARMTH[c]) } else { light[c] })
}

/// The factors of light on a colour as a camera shows them: bright colours keep their hue.
fn exposed(colour: [f32; 3], light: [f32; 3]) -> [f32; 3] {
    let brightest = (0..3).map(|c| colour[c] * light[c]).fold(0.0, f32::max);
    let [shoulder, most] = SHOULDER;
    if brightest <= shoulder {
        return light;
    }
    let room = most - shoulder;
    let shown = shoulder + room * (1.0 - libm::expf((shoulder - brightest) / room));
    light.map(|factor| factor * shown / brightest)
}

/// Warm, white or cool.
fn tint(stream: &mut Stream) -> Vec3 {
    let warmth = stream.uniform(-0.12, 0.18);
    Vec3::new(1.0 + warmth, 1.0, 1.0 - warmth)
}

/// The direction with an azimuth to the subject's left and an elevation, in degrees; both zero is where the head looks.
fn direction(azimuth: f32, elevation: f32) -> Vec3 {
    let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
    let level = libm::cosf(elevation);
    Vec3::new(level * libm::sinf(azimuth), libm::sinf(elevation), level * libm::cosf(azimuth))
}

/// A normal of each triangle, averaged with its neighbours so that edges do not show.
fn normals(avatar: &Avatar, head: &PosedHead) -> Vec<Vec3> {
    let (vertices, triangles) = (head.vertices(), &avatar.model().triangles);
    let around = vertex_normals(vertices, triangles);
    let of = |triangle: &[u32; 3]| triangle.iter().map(|corner| around[*corner as usize]).sum::<Vec3>();
    triangles.iter().map(|triangle| of(triangle).normalize_or(Vec3::Z)).collect()
}

#[cfg(test)]
mod tests {
    use srflow_head::HeadPose;

    use super::*;

    fn posed(avatar: &Avatar) -> (PosedHead, Gaussians) {
        let (mut head, mut gaussians) = (PosedHead::default(), Gaussians::default());
        avatar.gaussians_into(&HeadPose::default(), &mut head, &mut gaussians);
        (head, gaussians)
    }

    #[test]
    fn the_lit_side_is_brighter_and_the_mean_stays() {
        let avatar = Avatar::builtin(2).unwrap();
        let (head, plain) = posed(&avatar);
        let left = Lamp { direction: Vec3::X, light: Vec3::splat(1.0) };
        let lamps = Lamps { ambient: Vec3::splat(0.5), lamps: vec![left], look: Look::First };
        let mut shaded = plain.clone();
        lamps.shade(&avatar, &head, &mut shaded);
        let colour = |sh: &[f32; 3]| 0.5 + SH_0 as f32 * sh[1];
        let change = |wanted: fn(f32) -> bool| {
            let places = plain.positions.iter().zip(plain.sh.iter().zip(&shaded.sh));
            let sums =
                places.filter(|(place, _)| wanted(place.x)).fold([0.0; 2], |sums, (_, (before, after))| {
                    [sums[0] + colour(before), sums[1] + colour(after)]
                });
            sums[1] / sums[0]
        };
        let (lit, unlit) = (change(|x| x > 0.05), change(|x| x < -0.05));
        assert!(lit > 1.03 && unlit < 0.9, "{lit} {unlit}");
        assert_eq!(plain.positions, shaded.positions);

        for scene in 0..50 {
            let lamps = Lamps::random(Key::new(3).scene(scene), 1.0, Look::Second);
            let front = lamps.at(Vec3::Z).element_sum() / 3.0;
            assert!((0.5..2.0).contains(&front), "{scene}: {front}");
        }
        let mut same = plain.clone();
        Lamps::random(Key::new(3), 0.0, Look::First).shade(&avatar, &head, &mut same);
        let pairs = same.sh.as_flattened().iter().zip(plain.sh.as_flattened());
        assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-4));
    }

    #[test]
    fn normals_point_outwards() {
        let avatar = Avatar::builtin(1).unwrap();
        let (head, _) = posed(&avatar);
        let centre = avatar.shaped().vertices.iter().sum::<Vec3>() / avatar.shaped().vertices.len() as f32;
        let triangles = &avatar.model().triangles;
        let outwards = normals(&avatar, &head)
            .into_iter()
            .zip(triangles)
            .filter(|(normal, triangle)| normal.dot(head.vertices()[triangle[0] as usize] - centre) > 0.0);
        assert!(outwards.count() * 10 > 7 * triangles.len());
    }
}
