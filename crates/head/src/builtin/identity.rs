use glam::{Vec2, Vec3};
use srflow_core::random::Key;

use super::form::MODES;
use crate::Look;

/// The traits of a head that is average but for one of them, by its value.
pub(super) type OneTrait = Box<dyn Fn(f32) -> Traits + Send + Sync>;

macro_rules! traits {
    ($($name:ident),* $(,)?) => {
        /// The traits that distinguish one person's head from another's: each is roughly normal with mean 0 and deviation 1,
        /// clamped to two deviations so that every combination looks human. The default is the average head.
        #[derive(Debug, Clone, Copy, Default, PartialEq)]
        pub(super) struct Traits {
            $(pub $name: f32,)*
            /// Weights of the ways in which faces differ; see [`super::form::Form`].
            pub form: [f32; MODES],
        }

        impl Traits {
            /// The average head but for one trait: its name, and a function of the trait's value.
            pub(super) fn each(look: Look) -> Vec<(String, OneTrait)> {
                let sculpted = [$((
                    stringify!($name).to_owned(),
                    Box::new(|$name| Self { $name, ..Self::default() }) as OneTrait,
                ),)*];
                let form = |mode: usize| {
                    let of = move |weight: f32| {
                        let mut traits = Self::default();
                        traits.form[mode] = weight;
                        traits
                    };
                    (format!("form_{}", mode + 1), Box::new(of) as OneTrait)
                };
                let modes = if look == Look::First { 0 } else { MODES };
                sculpted.into_iter().chain((0..modes).map(form)).collect()
            }

            /// With what is sculpted times `factor`.
            fn scaled(&self, factor: f32) -> Self {
                Self { $($name: self.$name * factor,)* form: self.form }
            }

            /// The values, in the same order.
            #[cfg(test)]
            pub(super) fn values(&self) -> Vec<f32> {
                [$(self.$name,)*].into_iter().chain(self.form).collect()
            }
        }
    };
}

traits! {
    head_width,
    head_length,
    crown_height,
    forehead_slope,
    brow_ridge,
    cheekbones,
    cheek_fullness,
    face_length,
    jaw_width,
    chin_width,
    chin_projection,
    chin_height,
    nose_length,
    nose_width,
    nose_bridge,
    nose_hump,
    nose_tip,
    nose_turn,
    mouth_width,
    upper_lip,
    lower_lip,
    eye_opening,
    eye_width,
    eye_spacing,
    eye_tilt,
    eye_depth,
    lid_crease,
    ear_size,
    ear_protrusion,
    neck_girth,
}

impl Traits {
    /// The traits of the person of `seed`.
    pub(super) fn of(seed: u64, look: Look) -> Self {
        let draw = |purpose: &str| Key::new(seed).stream(purpose).normal().clamp(-2.0, 2.0);
        // A shared factor moves several traits together, as between typical male and female heads.
        let build = draw("head: build");
        let with_build = |purpose: &str, share: f32| (0.8 * draw(purpose) + share * build).clamp(-2.0, 2.0);
        let sculpted = Self {
            head_width: draw("head: width"),
            head_length: draw("head: length"),
            crown_height: draw("head: crown height"),
            forehead_slope: with_build("head: forehead slope", 0.5),
            brow_ridge: with_build("head: brow ridge", 0.8),
            cheekbones: draw("head: cheekbones"),
            cheek_fullness: with_build("head: cheek fullness", -0.3),
            face_length: with_build("head: face length", 0.3),
            jaw_width: with_build("head: jaw width", 0.6),
            chin_width: with_build("head: chin width", 0.5),
            chin_projection: with_build("head: chin projection", 0.3),
            chin_height: with_build("head: chin height", 0.4),
            nose_length: with_build("head: nose length", 0.2),
            nose_width: draw("head: nose width"),
            nose_bridge: draw("head: nose bridge"),
            nose_hump: with_build("head: nose hump", 0.3),
            nose_tip: draw("head: nose tip"),
            nose_turn: with_build("head: nose turn", -0.3),
            mouth_width: draw("head: mouth width"),
            upper_lip: with_build("head: upper lip", -0.4),
            lower_lip: with_build("head: lower lip", -0.3),
            eye_opening: with_build("head: eye opening", -0.4),
            eye_width: draw("head: eye width"),
            eye_spacing: draw("head: eye spacing"),
            eye_tilt: draw("head: eye tilt"),
            eye_depth: with_build("head: eye depth", 0.4),
            lid_crease: with_build("head: lid crease", -0.5),
            ear_size: with_build("head: ear size", 0.3),
            ear_protrusion: draw("head: ear protrusion"),
            neck_girth: with_build("head: neck girth", 0.9),
            ..Self::default()
        };
        if look == Look::First { sculpted } else { sculpted.with_form(draw) }
    }

    /// With a form drawn for the person. What is sculpted varies less: the form has most of how faces differ, but for lids, lips and ears.
    fn with_form(self, draw: impl Fn(&str) -> f32) -> Self {
        const SCULPTED: f32 = 0.6;
        let Self { eye_opening, eye_width, eye_tilt, lid_crease, upper_lip, lower_lip, .. } = self;
        let Self { nose_length, nose_width, nose_bridge, nose_hump, nose_tip, nose_turn, .. } = self;
        let Self { ear_size, ear_protrusion, neck_girth, head_length, crown_height, .. } = self;
        Self {
            nose_length: 0.8 * nose_length,
            nose_width: 0.8 * nose_width,
            nose_bridge,
            nose_hump,
            nose_tip: 0.8 * nose_tip,
            nose_turn,
            eye_opening: 1.2 * eye_opening,
            eye_width,
            eye_tilt: 1.4 * eye_tilt,
            lid_crease: 1.3 * lid_crease,
            upper_lip,
            lower_lip,
            ear_size,
            ear_protrusion,
            neck_girth,
            head_length,
            crown_height,
            // Clamped at two deviations, a normal number deviates by 0.88.
            form: std::array::from_fn(|mode| 1.1 * draw(&format!("head: form {}", mode + 1))),
            ..self.scaled(SCULPTED)
        }
    }
}

/// One person's measures, shared by all sculpting stages, in millimetres, for the left half (`x >= 0`). +y is up, +z out of
/// the face, and the origin is between the ears.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub look: Look,
    pub traits: Traits,
    pub eye: Vec3,
    pub eye_radius: f32,
    pub inner_canthus: Vec2,
    pub outer_canthus: Vec2,
    /// Height of the upper lid's margin above the line between the canthi, and depth of the lower one's below it.
    pub lid_heights: [f32; 2],
    /// Height of the lid crease above the upper margin.
    pub crease: f32,
    /// Junction of the nose and the upper lip.
    pub nose_base: f32,
    pub mouth: f32,
    pub mouth_half_width: f32,
    /// Heights of the vermilion of the upper and lower lip at the midline.
    pub lip_heights: [f32; 2],
    pub chin: f32,
}

/// Heights of the average face, before a person's proportions: eye, nose base, mouth, chin.
pub(super) const CANON: [f32; 4] = [28.0, -21.0, -43.0, -88.0];

impl Plan {
    pub(super) fn new(traits: Traits, look: Look) -> Self {
        let t = &traits;
        let spacing = 31.5 + 1.2 * t.eye_spacing;
        let width = if look == Look::First { 29.0 } else { 30.2 } + t.eye_width;
        let inner = spacing - 0.515 * width;
        let eye = Vec3::new(spacing, CANON[0], 69.5 - 0.9 * t.eye_depth);
        let nose_base = CANON[1] - 2.0 * t.nose_length - 1.2 * t.face_length;
        let mouth = nose_base + (CANON[2] - CANON[1]) - 1.1 * t.face_length;
        Self {
            eye,
            eye_radius: 12.2,
            inner_canthus: Vec2::new(inner, eye.y - 3.0 - 0.2 * t.eye_tilt),
            outer_canthus: Vec2::new(inner + width, eye.y - 1.2 + 1.0 * t.eye_tilt),
            lid_heights: [
                if look == Look::First { 6.5 } else { 7.0 } + 0.5 * t.eye_opening,
                4.2 + 0.3 * t.eye_opening,
            ],
            crease: 4.6 + 0.9 * t.lid_crease,
            nose_base,
            mouth,
            mouth_half_width: 25.0 + 1.7 * t.mouth_width,
            lip_heights: [6.8 + 1.3 * t.upper_lip, 8.8 + 1.4 * t.lower_lip],
            chin: mouth + (CANON[3] - CANON[2]) - 2.2 * t.chin_height,
            look,
            traits,
        }
    }

    /// Maps a height of the average face to this person: eyes are fixed, and everything below moves with nose, mouth and chin.
    pub(super) fn height(&self, canon: f32) -> f32 {
        let here = [self.eye.y, self.nose_base, self.mouth, self.chin];
        if canon >= CANON[0] {
            return canon;
        }
        for i in 0..3 {
            if canon >= CANON[i + 1] {
                let t = (CANON[i] - canon) / (CANON[i] - CANON[i + 1]);
                return here[i] + (here[i + 1] - here[i]) * t;
            }
        }
        canon + here[3] - CANON[3]
    }
}
