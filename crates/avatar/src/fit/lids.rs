//! How far the lids are closed: a closed lid shows skin where the eye would be. The landmarks of detectors close less than lids do.

use glam::Vec3;
use rayon::prelude::*;
use srflow_core::median;
use srflow_head::{HeadState, ShapedHead, Side};

use super::gaze::belongs_to;
use super::pictures::{Patch, Pictures};
use super::problem::{Heads, Problem};
use crate::surface::opaque_triangles;
use crate::visible_surface;

/// The blink of FACS.
const BLINK: u8 = 45;

/// Lids may be closed by so many tenths of a blink more than the landmarks say.
const MOST: usize = 10;

/// The skin around an eye reaches this far, in distances between the outer corners of the eyes.
const RIM: f64 = 0.08;

/// Neighbouring pixels are alike: all of them tell as much as this share of independent ones.
const INDEPENDENT: f64 = 0.2;

/// Lids stay as they are unless the pictures are more probable by this, as a logarithm.
const ENOUGH: f64 = 3.0;

/// How often the looks of eyes are found anew, without the pixels that lids turned out to cover.
const ROUNDS: usize = 3;

/// An expression of a blink, and its weight when the eye is closed.
type Blink = Vec<(usize, f64)>;

/// How a pixel differs from the skin around the eye, in logarithms of levels: in brightness, and in red less blue.
type Look = [f64; 2];

/// An eye at a timestep.
#[derive(Default)]
struct Opening {
    /// Pixels of the eyeball: their looks, and a bit for each closure, in tenths, that leaves them uncovered.
    eye: Vec<(Look, u16)>,
    skin: Vec<Look>,
}

impl Problem<'_> {
    /// Closes the lids at each timestep as far as its pictures show. Models without blinks stay as they are.
    pub fn close_lids(&self, heads: &mut Heads, pictures: &Pictures) {
        let blinks = [Side::Left, Side::Right].map(|side| self.blink(side));
        if blinks.iter().any(Vec::is_empty) {
            return;
        }
        let (shaped, triangles) = (self.shaped(heads), opaque_triangles(self.model));
        let openings: Vec<[Opening; 2]> = (0..heads.states.len())
            .into_par_iter()
            .map(|timestep| {
                let surfaces = self.closing(heads.state(timestep), &shaped, &blinks);
                self.openings(&surfaces, &triangles, pictures.of_timestep(timestep))
            })
            .collect();
        let closures = closures(openings.as_flattened());
        for (state, closures) in heads.states.iter_mut().zip(closures.chunks_exact(2)) {
            blinks.iter().zip(closures).for_each(|(blink, tenths)| self.close(state, blink, *tenths));
        }
    }

    /// The blink of one eye, of expressions that are fitted.
    fn blink(&self, side: Side) -> Blink {
        let units = self.model.action_units.iter().filter(|unit| unit.number == BLINK && unit.side == side);
        let expressions = units.flat_map(|unit| &unit.expressions);
        let fitted = expressions.filter(|(expression, _)| *expression < self.expressions);
        fitted.map(|(expression, weight)| (*expression, f64::from(*weight))).collect()
    }

    fn close(&self, state: &mut HeadState, blink: &Blink, tenths: usize) {
        for &(expression, weight) in blink {
            let before = state.expressions[expression];
            let mut after = before + weight * tenths as f64 / 10.0;
            if let Some([low, high]) = self.ranges[expression] {
                after = after.clamp(low.min(before), high.max(before));
            }
            state.expressions[expression] = after;
        }
    }

    /// The surface of a head as both lids close, tenth by tenth.
    fn closing(&self, state: &HeadState, shaped: &ShapedHead, blinks: &[Blink; 2]) -> Vec<Vec<Vec3>> {
        let closed = |tenths| {
            let mut state = state.clone();
            blinks.iter().for_each(|blink| self.close(&mut state, blink, tenths));
            let mut posed = Vec::new();
            self.model.vertices(shaped, &state.pose(), &mut posed);
            self.model.surface(&posed).0.to_vec()
        };
        (0..=MOST).map(closed).collect()
    }

    /// Both eyes in the pictures of a timestep.
    fn openings<'p>(
        &self,
        surfaces: &[Vec<Vec3>],
        triangles: &[[u32; 3]],
        patches: impl Iterator<Item = &'p Patch>,
    ) -> [Opening; 2] {
        let mut openings = [(); 2].map(|()| Opening::default());
        for patch in patches {
            let seen: Vec<Vec<Option<usize>>> = surfaces
                .iter()
                .map(|surface| {
                    let points = visible_surface(surface, triangles, &patch.camera).into_iter();
                    points.map(|point| Some(point?.triangle)).collect()
                })
                .collect();
            let of_head: Vec<bool> = seen[0].iter().map(Option::is_some).collect();
            for (opening, eyeball) in openings.iter_mut().zip(&self.model.eyeballs) {
                let mut uncovered = vec![0; of_head.len()];
                for (tenths, triangle_at) in seen.iter().enumerate() {
                    for (bits, triangle) in uncovered.iter_mut().zip(triangle_at) {
                        let is_eye =
                            triangle.is_some_and(|triangle| belongs_to(eyeball, triangles[triangle]));
                        *bits |= u16::from(is_eye) << tenths;
                    }
                }
                opening.add(patch, &of_head, &uncovered);
            }
        }
        openings
    }
}

impl Opening {
    /// Adds a picture. `uncovered` has a bit for each closure with which a pixel shows the eyeball.
    fn add(&mut self, patch: &Patch, of_head: &[bool], uncovered: &[u16]) {
        let (width, height) = (patch.camera.width, patch.camera.height);
        let reach = (RIM * patch.corners).ceil() as usize;
        let is_near = |pixel: usize| {
            let around = |at: usize, side: usize| at.saturating_sub(reach)..(at + reach + 1).min(side);
            let columns = around(pixel % width, width);
            let mut rows = around(pixel / width, height);
            rows.any(|row| uncovered[row * width..][columns.clone()].iter().any(|bits| *bits != 0))
        };
        let is_skin = |pixel: &usize| of_head[*pixel] && uncovered[*pixel] == 0 && is_near(*pixel);
        let skin: Vec<usize> = (0..width * height).filter(is_skin).collect();
        if skin.is_empty() {
            return;
        }
        let level = |channel: usize, pixel: usize| f64::from(patch.channels[channel].pixels()[pixel]);
        let usual = [0, 1, 2].map(|channel| median(skin.iter().map(|pixel| level(channel, *pixel))));
        let look = |pixel: usize| -> Look {
            let [r, g, b] = [0, 1, 2].map(|channel| level(channel, pixel) - usual[channel]);
            [(r + g + b) / 3.0, r - b]
        };
        self.skin.extend(skin.iter().map(|pixel| look(*pixel)));
        let eye = (0..width * height).filter(|pixel| uncovered[*pixel] != 0);
        self.eye.extend(eye.map(|pixel| (look(pixel), uncovered[pixel])));
    }

    /// The most probable closure, in tenths.
    fn closure(&self, eye: &Looks, skin: &Looks) -> usize {
        let probability = |tenths: usize| -> f64 {
            let of_pixel = |(look, uncovered): &(Look, u16)| {
                let is_eye = uncovered >> tenths & 1 == 1;
                (if is_eye { eye } else { skin }).logarithm(look)
            };
            INDEPENDENT * self.eye.iter().map(of_pixel).sum::<f64>()
        };
        let as_it_is = (0, probability(0) + ENOUGH);
        let closed = (1..=MOST).map(|tenths| (tenths, probability(tenths)));
        closed.fold(as_it_is, |best, closed| if closed.1 > best.1 { closed } else { best }).0
    }
}

/// How far each eye is closed, in tenths.
fn closures(openings: &[Opening]) -> Vec<usize> {
    let skin = Looks::of(openings.iter().flat_map(|opening| &opening.skin));
    let mut closures = vec![0; openings.len()];
    for _ in 0..ROUNDS {
        let uncovered = openings.iter().zip(&closures).flat_map(|(opening, tenths)| {
            let shows = move |(_, uncovered): &&(Look, u16)| uncovered >> tenths & 1 == 1;
            opening.eye.iter().filter(shows).map(|(look, _)| look)
        });
        let eye = Looks::of(uncovered);
        closures = openings.iter().map(|opening| opening.closure(&eye, &skin)).collect();
    }
    closures
}

/// A histogram of looks.
struct Looks {
    /// Of the share of each bin.
    logarithms: Vec<f64>,
}

impl Looks {
    const BINS: usize = 32;

    /// Bins reach from minus to plus this.
    const REACH: Look = [2.0, 1.0];

    /// A look may be any with this probability.
    const ANY: f64 = 0.05;

    fn of<'l>(looks: impl Iterator<Item = &'l Look>) -> Self {
        const SMOOTH: [(isize, f64); 3] = [(-1, 0.25), (0, 0.5), (1, 0.25)];
        let mut counts = vec![0.0; Self::BINS * Self::BINS];
        let mut total = 0.0;
        for look in looks {
            total += 1.0;
            let bins = Self::bins(look);
            let beside = |axis: usize, by: isize| bins[axis].saturating_add_signed(by).min(Self::BINS - 1);
            for (down, y) in SMOOTH {
                for (right, x) in SMOOTH {
                    counts[beside(1, down) * Self::BINS + beside(0, right)] += x * y;
                }
            }
        }
        let share = |count: f64| {
            Self::ANY / (Self::BINS * Self::BINS) as f64 + (1.0 - Self::ANY) * count / f64::max(total, 1.0)
        };
        Self { logarithms: counts.into_iter().map(|count| libm::log(share(count))).collect() }
    }

    fn bins(look: &Look) -> [usize; 2] {
        std::array::from_fn(|axis| {
            let share = (look[axis] / Self::REACH[axis] + 1.0) / 2.0;
            ((share * Self::BINS as f64) as usize).min(Self::BINS - 1)
        })
    }

    fn logarithm(&self, look: &Look) -> f64 {
        let [x, y] = Self::bins(look);
        self.logarithms[y * Self::BINS + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lids_close_as_far_as_the_skin_reaches() {
        // Eyes of ten rows, one less with each tenth; dark in the middle, bright beside it.
        let eye = |covered: usize| {
            let noise = |at: usize| 0.1 * ((at * 7919 % 101) as f64 / 101.0 - 0.5);
            let pixel = |at: usize| {
                let (x, y) = (at % 20, at / 20);
                let look = match x {
                    _ if y < covered => noise(at),
                    7..13 => noise(at) - 1.0,
                    _ => noise(at) + 0.5,
                };
                let uncovered = (0..=MOST).filter(|tenths| y >= *tenths).map(|tenths| 1 << tenths).sum();
                ([look, look / 4.0], uncovered)
            };
            let skin = |at: usize| [noise(at), noise(at) / 4.0];
            Opening { eye: (0..200).map(pixel).collect(), skin: (0..300).map(skin).collect() }
        };
        let covered = [0, 0, 0, 3, 10, 6, 0, 0, 0, 0];
        assert_eq!(closures(&covered.map(eye)), covered);
        assert!(closures(&[]).is_empty());
        assert_eq!(closures(&[Opening::default()]), [0]);
    }
}
