//! The colour and relief of the skin at every point: lips, flush, beard shadow and clothing.

use glam::Vec3;
use srflow_core::random::Stream;

use super::appearance::{Appearance, HairStyle};
use super::light::{Exposure, Material, SKIN_WRAP, Studio};
use super::noise::Noise;
use super::surface::{Surface, SurfacePoint};
use super::{Dressing, smoothstep};
use crate::{Look, Region};

const MM: f32 = 1e-3;

/// The complexion of one person. Lengths refer to an average head: positions are divided by the head's size.
pub(super) struct Complexion<'a> {
    surface: &'a Surface<'a>,
    look: Look,
    appearance: Appearance,
    places: Places,
    /// Distance into the lips and the scalp, metres, at the vertices.
    lips: Vec<f32>,
    scalp: Vec<f32>,
    /// Distance from the open edge of the model, metres, at the vertices.
    rim: Vec<f32>,
    /// Curvature of the surface at the vertices, 1/m.
    curvature: Vec<f32>,
    blotches: Noise,
    relief: Noise,
}

/// Positions of the parts of the face.
struct Places {
    cheeks: [Vec3; 2],
    nose_tip: Vec3,
    nose_wings: [Vec3; 2],
    /// From the second look on.
    nostrils: Option<[Vec3; 2]>,
    chin: Vec3,
    eyes: [Vec3; 2],
    bags: [Vec3; 2],
    mouth_corner: Vec3,
    ear: Vec3,
    brow_height: f32,
}

impl Places {
    fn new(surface: &Surface, look: Look) -> Self {
        let l: Vec<Vec3> = surface.landmarks.iter().map(|&p| p / surface.size).collect();
        let cheek = |lid: usize, mouth: usize, jaw: usize| l[lid] * 0.42 + l[mouth] * 0.26 + l[jaw] * 0.32;
        let bag = |a: usize, b: usize| (l[a] + l[b]) * 0.5 - Vec3::Y * (7.0 * MM);
        let outward = |p: Vec3| Vec3::new(p.x.abs(), p.y, p.z);
        Self {
            cheeks: [cheek(41, 48, 2), cheek(46, 54, 14)],
            nose_tip: l[30],
            nose_wings: [l[31], l[35]],
            nostrils: (look >= Look::Second)
                .then(|| [31, 35].map(|wing| l[wing].lerp(l[33], 0.46) + Vec3::new(0.0, 1.0, 0.5) * MM)),
            chin: l[8],
            eyes: [1, 0].map(|eye| surface.eyes[eye] / surface.size),
            bags: [bag(40, 41), bag(46, 47)],
            mouth_corner: (outward(l[48]) + outward(l[54])) * 0.5,
            ear: (outward(l[0]) + outward(l[16])) * 0.5,
            brow_height: l[19].y.max(l[24].y),
        }
    }
}

/// A Gaussian around `centre` with `sigma` in millimetres: 1 at the centre.
fn spot(p: Vec3, centre: Vec3, sigma: f32) -> f32 {
    libm::expf(-p.distance_squared(centre) / (2.0 * (sigma * MM) * (sigma * MM)))
}

impl<'a> Complexion<'a> {
    pub fn new(dressing: &Dressing<'a>) -> Self {
        let surface = dressing.surface;
        let mut stream = dressing.stream("complexion");
        Self {
            surface,
            look: dressing.look,
            appearance: dressing.appearance.clone(),
            places: Places::new(surface, dressing.look),
            lips: surface.signed_distance(&[Region::Lips], 0.02),
            scalp: surface.signed_distance(&[Region::Scalp], 0.03),
            rim: surface.rim_distance(0.02),
            curvature: surface.curvature(),
            blotches: Noise::new(stream.bits()),
            relief: Noise::new(stream.bits()),
        }
    }

    /// Spacing in metres of the smallest Gaussians: fine on the face, coarse under hair and clothing.
    pub fn spacing(&self, point: &SurfacePoint) -> f32 {
        let p = point.position / self.surface.size;
        let front = smoothstep((p.z - self.places.ear.z) / (30.0 * MM));
        // Finer at the edges of clothing and of the model.
        let rim = self.surface.value(&self.rim, point) / self.surface.size;
        let neckline = 1.0 - smoothstep((self.cloth(point).abs() - 3.0 * MM) / (5.0 * MM));
        let edge = neckline.max(1.0 - smoothstep((rim - 2.0 * MM) / (5.0 * MM)));
        let mm = match self.surface.model.regions[point.triangle as usize] {
            Region::Lips | Region::LidMargin => 0.5,
            Region::Brow => 0.85,
            Region::Skin if self.is_beside_ear(p) => self.ear_spacing(point),
            Region::Skin => 1.35 - 0.53 * front * smoothstep((point.normal.z + 0.5) / 0.8),
            Region::Neck => 1.9 - 1.1 * edge,
            // Finer at the hairline, where it shows.
            Region::Scalp if self.look >= Look::Second => {
                let scalp = self.surface.value(&self.scalp, point) / self.surface.size;
                1.0 + 1.5 * smoothstep((scalp - 2.0 * MM) / (12.0 * MM))
            }
            _ => 2.5,
        };
        mm * MM * self.surface.size
    }

    /// Whether a coarse Gaussian here would reach beyond the edge of the model.
    pub fn is_rim(&self, point: &SurfacePoint) -> bool {
        self.surface.value(&self.rim, point) < 2.5 * MM * self.surface.size
    }

    /// Spacing fine enough on the ear that Gaussians deviate from its thin rim by less than a tenth of a millimetre.
    fn ear_spacing(&self, point: &SurfacePoint) -> f32 {
        let radius_mm =
            (self.surface.value(&self.curvature, point) * self.surface.size * MM).max(1e-3).recip();
        (0.6 * radius_mm.sqrt()).clamp(0.42, 0.95)
    }

    /// Spacing in metres of the larger Gaussians that close the surface. At the thin rim of the ear they would be visible.
    pub fn closing_spacing(&self, point: &SurfacePoint) -> f32 {
        let spacing = self.spacing(point);
        let sharp = self.surface.value(&self.curvature, point) * self.surface.size * MM > 0.22;
        if sharp && self.is_beside_ear(point.position / self.surface.size) {
            return spacing * 1.15;
        }
        (spacing * 2.0).max(1.2 * MM * self.surface.size)
    }

    /// The ear and the skin that its lobule is attached to.
    fn is_beside_ear(&self, p: Vec3) -> bool {
        p.x.abs() > self.places.ear.x - 8.0 * MM && p.z < self.places.ear.z + 2.0 * MM
    }

    fn is_ear(&self, p: Vec3) -> bool {
        p.x.abs() > self.places.ear.x + 3.0 * MM && p.z < self.places.ear.z + 2.0 * MM
    }

    /// Density of the beard, `0..=1`.
    pub fn beard(&self, point: &SurfacePoint) -> f32 {
        let p = point.position / self.surface.size;
        let places = &self.places;
        if self.lip(point) > 0.0 || p.z < places.ear.z - 12.0 * MM || self.is_ear(p) {
            return 0.0;
        }
        let x = p.x.abs();
        let corner = places.mouth_corner;
        // The upper border rises from the moustache to the sideburns.
        let nose = places.nose_wings[0].y - 3.0 * MM;
        let outward = (x - corner.x).max(0.0) / (places.ear.x - corner.x).max(MM);
        let border =
            if x < corner.x { nose } else { nose - 9.0 * MM + (places.ear.y - nose + 9.0 * MM) * outward };
        let throat = smoothstep((p.y - places.chin.y + 38.0 * MM) / (25.0 * MM));
        let under_lip = 1.0 - 0.6 * spot(p, Vec3::new(0.0, corner.y - 14.0 * MM, corner.z + 10.0 * MM), 6.0);
        let (border, width) = match self.look {
            Look::First => (border, 9.0),
            // It thins out in patches, but not over the lip.
            Look::Second => {
                let aside = smoothstep((x - corner.x) / (8.0 * MM));
                (border + (5.0 + 7.0 * self.relief.at(p * 60.0)) * aside * MM, 9.0 + 12.0 * aside)
            }
        };
        smoothstep((border - p.y) / (width * MM)) * throat * under_lip
    }

    /// Susceptibility to freckles.
    pub fn sun(&self, p: Vec3) -> f32 {
        let p = p / self.surface.size;
        let cheeks: f32 = self.places.cheeks.iter().map(|&c| spot(p, c, 17.0)).sum();
        (cheeks + 0.9 * spot(p, self.places.nose_tip + Vec3::Y * (15.0 * MM), 14.0) + 0.06).min(1.0)
    }

    /// Openness of pores.
    pub fn pores(&self, p: Vec3) -> f32 {
        let p = p / self.surface.size;
        let cheeks: f32 = self.places.cheeks.iter().map(|&c| spot(p, c - Vec3::X * (c.x * 0.25), 17.0)).sum();
        let chin = spot(p, self.places.chin, 16.0);
        let forehead = 0.6 * smoothstep((p.y - self.places.brow_height) / (10.0 * MM));
        let lids: f32 = self.places.eyes.iter().map(|&e| spot(p, e, 15.0)).sum();
        ((cheeks + chin + forehead + spot(p, self.places.nose_tip, 17.0)) - lids).clamp(0.0, 1.0)
    }

    /// Distance into the lips, metres.
    pub fn lip(&self, point: &SurfacePoint) -> f32 {
        self.surface.value(&self.lips, point) / self.surface.size
    }

    /// Distance below the neckline, metres: positive on clothing.
    pub fn cloth(&self, point: &SurfacePoint) -> f32 {
        let p = point.position / self.surface.size;
        let forward = p.z - (self.places.ear.z - 40.0 * MM);
        let neckline = self.places.chin.y
            - 60.0 * MM
            - 0.42 * forward / (1.0 + forward * forward / (0.07 * 0.07)).sqrt();
        neckline - p.y
    }

    /// Position of a skin Gaussian: clothing is offset from the skin.
    pub fn position(&self, point: &SurfacePoint) -> Vec3 {
        let cloth = self.cloth(point);
        let collar = 1.0 - smoothstep((cloth - 13.0 * MM) / (2.0 * MM));
        // The seam between the lips is closed at rest, even if the model has a gap.
        if self.lip(point) > 0.0 && point.normal.z < 0.55 {
            return point.position + point.normal * (0.3 * MM * self.surface.size);
        }
        let thickness = (2.0 + 1.0 * collar) * smoothstep((cloth + 0.2 * MM) / (0.8 * MM));
        point.position + point.normal * (thickness * MM * self.surface.size)
    }

    /// sRGB of the surface. `fine` adds grain that only small Gaussians can represent.
    pub fn color(&self, point: &SurfacePoint, exposure: &Exposure, stream: &mut Stream, fine: bool) -> Vec3 {
        let p = point.position / self.surface.size;
        let mut cloth = self.cloth(point);
        if self.look >= Look::Second && !fine {
            // Coarse Gaussians would fray the neckline.
            cloth -= 2.5 * MM;
        }
        if cloth > 0.0 {
            return self.cloth_color(p, point.normal, cloth, exposure);
        }
        let into_lips = self.lip(point);
        let soft = if self.look == Look::First { 0.9 * MM } else { 1.5 * MM };
        let lip = smoothstep((into_lips + soft) / (2.0 * soft));
        let mut albedo = self.skin_albedo(point, p).lerp(self.lip_albedo(p, into_lips), lip);
        albedo *= 1.0 - 0.35 * smoothstep((cloth + 5.0 * MM) / (5.0 * MM));
        let normal = if fine {
            albedo *= 1.0 + stream.uniform(-0.04, 0.04);
            self.relief_normal(point.normal, p, lip)
        } else {
            point.normal
        };
        let oily = spot(p, self.places.nose_tip, 16.0)
            + 0.7 * smoothstep((p.y - self.places.brow_height) / (15.0 * MM));
        let oily = oily.min(1.0);
        let (sheen, gloss) = match self.look {
            Look::First => (0.035 + 0.035 * oily, 13.0),
            // Oil shines in small highlights between the pores.
            Look::Second => (0.05 + 0.085 * oily, 22.0 + 12.0 * oily),
        };
        let (sheen, gloss) = (sheen + 0.055 * lip, gloss + 14.0 * lip);
        let material = Material { albedo, wrap: SKIN_WRAP, sheen, gloss };
        Studio::of(self.look).shade(&material, normal, exposure)
    }

    fn skin_albedo(&self, point: &SurfacePoint, p: Vec3) -> Vec3 {
        let (a, places) = (&self.appearance, &self.places);
        let mut albedo = a.skin;
        let blotch = self.blotches.fractal(p * 55.0, 4);
        albedo *= Vec3::new(1.0 + 0.05 * blotch, 1.0 + 0.075 * blotch, 1.0 + 0.08 * blotch);
        let cheeks: f32 = places.cheeks.iter().map(|&c| spot(p, c, 15.0)).sum();
        let wings: f32 = places.nose_wings.iter().map(|&w| spot(p, w, 7.0)).sum();
        let ears = smoothstep((p.x.abs() - places.ear.x - 6.0 * MM) / (8.0 * MM));
        let flush = 0.8 * cheeks
            + 0.9 * spot(p, places.nose_tip, 11.0)
            + 0.7 * wings
            + 0.8 * ears
            + 0.35 * spot(p, places.chin, 12.0);
        let flush = (flush * a.flush * (1.0 + 0.5 * self.blotches.at(p * 140.0))).clamp(0.0, 1.3);
        albedo *= Vec3::ONE.lerp(Vec3::new(1.02, 0.80, 0.77), flush * (1.0 - 0.55 * a.melanin));
        if let Some(nostrils) = places.nostrils {
            // Little light comes back out of them.
            let down = smoothstep((0.3 - point.normal.y) / 0.9);
            let inside: f32 = nostrils.iter().map(|&n| spot(p, n, 2.5)).sum();
            let deep: f32 = nostrils.iter().map(|&n| spot(p, n, 1.7)).sum();
            // Nor out of the corner below, between nose and lip.
            let corner = 0.2 * spot(p, (nostrils[0] + nostrils[1]) * 0.5 - Vec3::Y * (2.5 * MM), 3.5);
            albedo *= Vec3::ONE
                - Vec3::new(0.84, 0.92, 0.92) * (1.5 * inside * down + 0.8 * deep + corner).min(1.0);
        }
        let bags: f32 = places.bags.iter().map(|&b| spot(p, b, 7.5)).sum();
        let lids: f32 = places.eyes.iter().map(|&e| spot(p, e + Vec3::Z * (12.0 * MM), 10.0)).sum();
        albedo *= Vec3::ONE.lerp(Vec3::new(0.82, 0.74, 0.76), (0.45 + 0.4 * a.age) * bags.min(1.0));
        albedo *= Vec3::ONE.lerp(Vec3::new(0.90, 0.76, 0.74), 0.6 * lids.min(1.0));
        let beard = if a.stubble > 0.0 { self.beard(point) * a.stubble } else { 0.0 };
        albedo = albedo.lerp(albedo * Vec3::new(0.62, 0.64, 0.68), 0.55 * beard);
        let hair = match a.hair_style {
            HairStyle::Buzzed => 0.62,
            HairStyle::Short => 0.86,
            _ => 0.95,
        };
        let scalp = self.surface.value(&self.scalp, point) / self.surface.size;
        let covered = match self.look {
            Look::First => (scalp + self.blotches.at(p * 300.0) * 2.5 * MM) / (9.0 * MM),
            // Hair thins out towards the hairline.
            Look::Second => {
                let ragged = self.blotches.at(p * 900.0) * 1.2 + self.blotches.at(p * 110.0) * 2.5 - 1.5;
                (scalp + ragged * MM) / (17.0 * MM)
            }
        };
        albedo.lerp(a.hair * 0.5, hair * smoothstep(covered))
    }

    fn lip_albedo(&self, p: Vec3, into_lips: f32) -> Vec3 {
        let lines = self.lip_lines(p);
        let even = self.appearance.lips * (1.0 + 0.14 * lines + 0.06 * self.blotches.at(p * 400.0));
        match self.look {
            Look::First => even,
            // Redder and darker to the line between the lips.
            Look::Second => {
                let inner = smoothstep((into_lips - 1.0 * MM) / (5.0 * MM));
                even * Vec3::new(1.0, 0.97, 0.97).lerp(Vec3::new(0.88, 0.74, 0.76), inner)
            }
        }
    }

    /// The fine vertical lines of the lips.
    fn lip_lines(&self, p: Vec3) -> f32 {
        let line = |f: f32| self.blotches.at(Vec3::new(p.x * f, p.y * f * 0.14, p.z * f * 0.3));
        0.6 * line(900.0) + 0.4 * line(2100.0)
    }

    /// Height of the skin's relief, in fractions of a millimetre.
    fn relief_height(&self, p: Vec3, lip: f32) -> f32 {
        let grain = 0.6 * self.relief.fractal(p * 620.0, 2) + 0.25 * self.relief.at(p * 190.0);
        let forehead = smoothstep((p.y - self.places.brow_height - 4.0 * MM) / (8.0 * MM))
            * (1.0 - smoothstep((p.y - self.places.brow_height - 24.0 * MM) / (16.0 * MM)))
            * (1.0 - smoothstep((p.x.abs() - 35.0 * MM) / (15.0 * MM)));
        let waver = self.relief.at(p * 28.0) * 0.55;
        let wave = libm::sinf((p.y / (9.5 * MM) + waver) * std::f32::consts::TAU);
        // Lines are narrow: only the troughs of the wave.
        let furrows = -libm::powf((0.5 - 0.5 * wave).max(0.0), 4.0) * forehead;
        (grain + 2.2 * self.appearance.age * self.appearance.age * furrows) * (1.0 - lip)
            + 1.3 * lip * self.lip_lines(p)
    }

    fn relief_normal(&self, normal: Vec3, p: Vec3, lip: f32) -> Vec3 {
        let d = 0.35 * MM;
        let slope =
            |axis: Vec3| self.relief_height(p + axis * d, lip) - self.relief_height(p - axis * d, lip);
        let gradient = Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z));
        let tangent = gradient - normal * normal.dot(gradient);
        let depth = match self.look {
            Look::First => 0.21,
            // Lids are smooth, and unroll into more light than the relief is shaded for.
            Look::Second => {
                let lids: f32 =
                    self.places.eyes.iter().map(|&e| spot(p, e + Vec3::new(0.0, 5.0, 12.0) * MM, 12.0)).sum();
                0.3 * (1.0 - 0.9 * lids.min(1.0))
            }
        };
        (normal - tangent * depth).normalize_or(normal)
    }

    fn cloth_color(&self, p: Vec3, normal: Vec3, cloth: f32, exposure: &Exposure) -> Vec3 {
        let weave = 1.0 + 0.06 * self.relief.fractal(p * 700.0, 2);
        let collar = 1.0 - smoothstep((cloth - 13.0 * MM) / (1.5 * MM));
        let around = libm::atan2f(p.x, p.z - self.places.ear.z + 40.0 * MM);
        let ribs = 1.0 + 0.10 * collar * libm::sinf(around * 170.0);
        let seam = 1.0 - 0.35 * spot(Vec3::X * cloth, Vec3::X * 14.0 * MM, 0.8);
        let albedo = self.appearance.garment * (weave * ribs * seam);
        let q = p * 26.0;
        let folds = Vec3::new(self.relief.at(q), self.relief.at(q + 41.0), self.relief.at(q + 83.0)) * 0.24;
        let exposure = Exposure { sky: exposure.sky.max(0.25), ..*exposure };
        let normal = (normal + folds).normalize_or(normal);
        Studio::of(self.look).shade(&Material::matt(albedo), normal, &exposure)
    }
}
