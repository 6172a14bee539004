//! Rotating the hue in Pillow's 8-bit HSV, whose conversions round in both directions.

/// Both conversions as lookup tables: there are few distinct inputs.
#[derive(Debug, Clone)]
pub(super) struct HueTables {
    /// Hue by sector (one of [`SECTORS`]), the range between the largest and smallest channel, and the gap between the largest
    /// and the middle one: `[(sector * 256 + range) * 256 + gap]`.
    hue: Vec<u8>,
    /// Saturation by range and value: `[range * 256 + value]`.
    saturation: Vec<u8>,
    /// The smallest channel by saturation and value: `[saturation * 256 + value]`.
    smallest: Vec<u8>,
    /// By hue.
    shades: Vec<Shade>,
}

/// The part of a colour that its hue determines, whatever its saturation and value.
#[derive(Debug, Clone, Copy)]
struct Shade {
    /// The order of value, middle and smallest channel in r, g and b.
    order: [u8; 3],
    /// How much of the saturation the middle channel lacks.
    lack: f64,
}

/// The sectors of the colour circle: the six orders of r, g, b by size.
const SECTORS: usize = 6;

impl HueTables {
    pub(super) fn new() -> Self {
        let mut hue = vec![0; SECTORS << 16];
        let mut saturation = vec![0; 1 << 16];
        let mut smallest = vec![0; 1 << 16];
        for (a, b) in (0..256).flat_map(|a| (0..256).map(move |b| (a, b))) {
            if 0 < a && b <= a {
                for sector in 0..SECTORS {
                    hue[(sector << 16) | (a << 8) | b] = hue_of(sector, a, b);
                }
            }
            if 0 < a && a <= b {
                saturation[(a << 8) | b] = (f64::from(a as f32 / b as f32) * 255.0) as u8;
            }
            smallest[(a << 8) | b] = less(b as u8, f64::from(a as f32 / 255.0));
        }
        Self { hue, saturation, smallest, shades: (0..=255).map(shade_of).collect() }
    }

    /// Rotates the hue of each pixel by this many 255ths of a turn. Rounding changes some pixels slightly even for zero.
    pub(super) fn turn(&self, pixels: &mut [[u8; 3]], steps: u8) {
        for pixel in pixels {
            if !is_grey(*pixel) {
                *pixel = self.turned(*pixel, steps);
            }
        }
    }

    fn turned(&self, [r, g, b]: [u8; 3], steps: u8) -> [u8; 3] {
        let value = r.max(g).max(b);
        let smallest = r.min(g).min(b);
        let range = usize::from(value - smallest);
        let sector = match (value == r, value == g) {
            (true, _) => usize::from(smallest != g),
            (_, true) => 2 + usize::from(smallest != b),
            _ => 4 + usize::from(smallest != r),
        };
        // The three sum to the same value in any order.
        let middle = (u16::from(r) + u16::from(g) + u16::from(b)) - u16::from(value) - u16::from(smallest);
        let gap = usize::from(value) - usize::from(middle);
        let hue = self.hue[(sector << 16) | (range << 8) | gap];
        let saturation = self.saturation[(range << 8) | usize::from(value)];
        let shade = &self.shades[usize::from(hue.wrapping_add(steps))];
        let middle = less(value, f64::from(f32::from(saturation) / 255.0) * shade.lack);
        let channels = [value, middle, self.smallest[(usize::from(saturation) << 8) | usize::from(value)]];
        shade.order.map(|which| channels[usize::from(which)])
    }
}

/// Whether a colour has neither hue nor saturation.
pub(super) fn is_grey([r, g, b]: [u8; 3]) -> bool {
    r == g && g == b
}

/// `value (1 - by)`, rounded.
fn less(value: u8, by: f64) -> u8 {
    (f64::from(value) * (1.0 - by) + 0.5) as u8
}

fn shade_of(hue: u8) -> Shade {
    let sixths = f64::from(f32::from(hue)) * 6.0 / 255.0;
    let part = f64::from((sixths - sixths.floor()) as f32);
    let (order, lack) = match sixths as u8 % 6 {
        0 => ([0, 1, 2], 1.0 - part),
        1 => ([1, 0, 2], part),
        2 => ([2, 0, 1], 1.0 - part),
        3 => ([2, 1, 0], part),
        4 => ([1, 2, 0], 1.0 - part),
        _ => ([0, 2, 1], part),
    };
    Shade { order, lack }
}

/// The position of a colour on the circle of 255 steps, computed in Pillow's precision.
fn hue_of(sector: usize, range: usize, gap: usize) -> u8 {
    let middle = gap as f32 / range as f32;
    let sixths = match sector {
        0 => middle - 1.0,                           // largest r, smallest g: b - g
        1 => 1.0 - middle,                           // largest r, smallest b
        2 => (2.0 + f64::from(middle) - 1.0) as f32, // largest g, smallest b: 2 + r - b
        3 => (2.0 + 1.0 - f64::from(middle)) as f32, // largest g, smallest r
        4 => (4.0 + f64::from(middle) - 1.0) as f32, // largest b, smallest r: 4 + g - r
        _ => (4.0 + 1.0 - f64::from(middle)) as f32, // largest b, smallest g
    };
    let turns = (f64::from(sixths) / 6.0 + 1.0) % 1.0;
    (f64::from(turns as f32) * 255.0) as u8
}
