//! A person's appearance apart from the shape of the head, drawn from the seed.

use glam::Vec3;
use srflow_core::random::{Key, Stream};

use crate::Look;
use crate::srgb::linear_from_srgb;

/// Hair style.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HairStyle {
    /// Some millimetres of stubble.
    Buzzed,
    /// A few centimetres, combed from the crown.
    Short,
    /// Combed sideways from a parting, over the ears.
    Medium,
    /// Tight curls that stand up.
    Curly,
    /// From a parting down to the neck and the shoulders.
    Long,
}

/// Colours are linear sRGB reflectances.
#[derive(Debug, Clone)]
pub(super) struct Appearance {
    pub skin: Vec3,
    /// 0 the lightest skin, 1 the darkest.
    pub melanin: f32,
    pub lips: Vec3,
    pub hair: Vec3,
    pub brows: Vec3,
    pub hair_style: HairStyle,
    pub iris: Vec3,
    /// Around the pupil, where many irises have another colour.
    pub iris_inner: Vec3,
    /// 0 none, 1 many.
    pub freckles: f32,
    /// 0 none or shaved, 1 several days old.
    pub stubble: f32,
    /// Redness of cheeks, nose and ears.
    pub flush: f32,
    pub garment: Vec3,
    /// Depth of wrinkles, 0 to 1.
    pub age: f32,
}

/// Skin colours from light to dark, sRGB, as photographed.
const SKIN_TONES: [[f32; 3]; 7] = [
    [0.918, 0.765, 0.690],
    [0.890, 0.714, 0.616],
    [0.843, 0.647, 0.533],
    [0.765, 0.557, 0.435],
    [0.643, 0.443, 0.329],
    [0.490, 0.325, 0.239],
    [0.353, 0.231, 0.180],
];

const HAIR_TONES: [[f32; 3]; 7] = [
    [0.090, 0.075, 0.070],
    [0.165, 0.115, 0.090],
    [0.255, 0.170, 0.120],
    [0.370, 0.250, 0.165],
    [0.560, 0.425, 0.275],
    [0.480, 0.240, 0.130],
    [0.600, 0.585, 0.570],
];

/// Outer and inner colour of irises: dark brown, brown, hazel, green, blue, grey.
const IRISES: [([f32; 3], [f32; 3]); 6] = [
    ([0.200, 0.115, 0.070], [0.255, 0.150, 0.085]),
    ([0.340, 0.205, 0.110], [0.430, 0.260, 0.130]),
    ([0.420, 0.355, 0.190], [0.510, 0.340, 0.150]),
    ([0.390, 0.450, 0.320], [0.520, 0.430, 0.240]),
    ([0.360, 0.490, 0.590], [0.500, 0.540, 0.520]),
    ([0.460, 0.510, 0.530], [0.520, 0.520, 0.470]),
];

impl Appearance {
    pub fn of(seed: u64, look: Look) -> Self {
        let drawn = Self::drawn(seed);
        if look == Look::First {
            return drawn;
        }
        // Beards go with the build of the head, and rarely with long hair.
        let build = Key::new(seed).stream("head: build").normal();
        let mut stream = Key::new(seed).stream("beard");
        let bearded = build > 0.0 && stream.unit() < 0.7;
        let stubble = if bearded { stream.uniform(0.2, 1.0) } else { 0.0 };
        let cut = build > 0.3 && drawn.hair_style == HairStyle::Long && stream.unit() < 0.85;
        let hair_style = if cut { HairStyle::Short } else { drawn.hair_style };
        // Beside skin, grey hairs look blue.
        let brows = drawn.brows * Vec3::new(1.12, 1.0, 0.85);
        Self {
            stubble,
            hair_style,
            iris: drawn.iris * 0.8,
            iris_inner: drawn.iris_inner * 0.8,
            brows,
            ..drawn
        }
    }

    fn drawn(seed: u64) -> Self {
        let mut stream = Key::new(seed).stream("appearance");
        let melanin = stream.unit();
        let warmth = stream.uniform(-1.0, 1.0);
        let tone = linear_from_srgb(ramp(&SKIN_TONES, melanin));
        let skin = tone * Vec3::new(1.0 + 0.03 * warmth, 1.0, 1.0 - 0.05 * warmth);
        let hair_index = hair_tone(melanin, &mut stream);
        let hair = linear_from_srgb(Vec3::from_array(HAIR_TONES[hair_index])) * stream.uniform(0.8, 1.2);
        let (iris, iris_inner) = IRISES[iris_index(melanin, &mut stream)];
        let lip_depth = stream.uniform(0.45, 0.95);
        let rose = Vec3::new(0.90, 0.44, 0.45).lerp(Vec3::new(0.80, 0.60, 0.62), melanin);
        Self {
            skin,
            melanin,
            lips: skin * Vec3::ONE.lerp(rose, lip_depth),
            hair,
            brows: if hair_index == 6 { hair * 0.5 } else { hair * 0.8 },
            hair_style: hair_style(melanin, &mut stream),
            iris: linear_from_srgb(Vec3::from_array(iris)),
            iris_inner: linear_from_srgb(Vec3::from_array(iris_inner)),
            freckles: if melanin < 0.45 && stream.unit() < 0.4 { stream.uniform(0.3, 1.0) } else { 0.0 },
            stubble: if stream.unit() < 0.38 { stream.uniform(0.3, 1.0) } else { 0.0 },
            flush: stream.uniform(0.5, 1.2),
            garment: garment(&mut stream),
            age: stream.unit(),
        }
    }
}

fn ramp(tones: &[[f32; 3]], t: f32) -> Vec3 {
    let at = t.clamp(0.0, 1.0) * (tones.len() - 1) as f32;
    let low = (at as usize).min(tones.len() - 2);
    Vec3::from_array(tones[low]).lerp(Vec3::from_array(tones[low + 1]), at - low as f32)
}

fn hair_tone(melanin: f32, stream: &mut Stream) -> usize {
    let draw = stream.unit();
    if draw < 0.08 {
        return 6;
    }
    if melanin > 0.55 {
        return usize::from(draw > 0.7);
    }
    [0, 1, 2, 3, 4, 5, 3][(draw * 6.99) as usize]
}

fn iris_index(melanin: f32, stream: &mut Stream) -> usize {
    let draw = stream.unit();
    if melanin > 0.55 { usize::from(draw > 0.7) } else { 1 + (draw * 4.99) as usize }
}

fn hair_style(melanin: f32, stream: &mut Stream) -> HairStyle {
    let draw = stream.unit();
    let curly = if melanin > 0.6 { 0.4 } else { 0.12 };
    if draw < curly {
        HairStyle::Curly
    } else {
        let styles =
            [HairStyle::Short, HairStyle::Medium, HairStyle::Long, HairStyle::Short, HairStyle::Buzzed];
        styles[(((draw - curly) / (1.0 - curly)) * 4.99) as usize]
    }
}

fn garment(stream: &mut Stream) -> Vec3 {
    let garments =
        [[0.16, 0.17, 0.19], [0.20, 0.24, 0.32], [0.42, 0.42, 0.41], [0.30, 0.18, 0.17], [0.21, 0.27, 0.22]];
    linear_from_srgb(Vec3::from_array(garments[stream.below(5) as usize]))
}
