//! The kernels of the method as plain scalar code over the whole image: the fast kernels must match them bit for bit.

use srflow_core::{Plane, Size};

use super::relaxation::{Constants, LANES};
use super::warp::{INVERSE_OF_NOTHING, cubic_weights};
use crate::planar::PlanarFlow;

/// The residual as a linear function of the flow: `constant + x u + y v`.
pub struct Residual {
    pub x: Plane,
    pub y: Plane,
    pub constant: Plane,
}

pub fn linearize(first: &Plane, second: &Plane, flow: &PlanarFlow) -> Residual {
    let Size { width, height } = first.size();
    let along = Plane::from_fn(width, height, |x, y| {
        0.5 * (second.get((x + 1).min(width - 1), y) - second.get(x.saturating_sub(1), y))
    });
    let down = Plane::from_fn(width, height, |x, y| {
        0.5 * (second.get(x, (y + 1).min(height - 1)) - second.get(x, y.saturating_sub(1)))
    });
    let warped = |plane: &Plane| {
        Plane::from_fn(width, height, |x, y| {
            interpolate(plane, x as f32 + flow.u.get(x, y), y as f32 + flow.v.get(x, y))
        })
    };
    let (x, y, value) = (warped(&along), warped(&down), warped(second));
    let constant = Plane::from_fn(width, height, |i, j| {
        value.get(i, j) - x.get(i, j) * flow.u.get(i, j) - y.get(i, j) * flow.v.get(i, j) - first.get(i, j)
    });
    Residual { x, y, constant }
}

/// Cubic convolution; zero outside the frame.
fn interpolate(plane: &Plane, x: f32, y: f32) -> f32 {
    let (width, height) = (plane.width() as f32, plane.height() as f32);
    let (left, top) = (x.floor(), y.floor());
    let (across, down) = (cubic_weights(x - left), cubic_weights(y - top));
    let pixel = |x: f32, y: f32| {
        if x >= 0.0 && x < width && y >= 0.0 && y < height { plane.get(x as usize, y as usize) } else { 0.0 }
    };
    let columns = [0, 1, 2, 3].map(|column| {
        [0, 1, 2, 3].iter().fold(0.0, |sum, &row| {
            let value = pixel(left - 1.0 + column as f32, top - 1.0 + row as f32);
            sum + value * (across[column] * down[row])
        })
    });
    columns[0] + columns[1] + columns[2] + columns[3]
}

/// One unknown function and its dual variable.
#[derive(Clone)]
pub struct Component {
    pub value: Plane,
    pub dual: [Plane; 2],
}

impl Component {
    pub fn new(value: Plane) -> Self {
        let Size { width, height } = value.size();
        Self { value, dual: [Plane::new(width, height), Plane::new(width, height)] }
    }
}

/// One iteration. Returns the squared change of all values, summed lane by lane along each row.
pub fn iterate(components: &mut [Component], residual: &Residual, constants: Constants) -> f64 {
    let Size { width, height } = residual.x.size();
    let pull = pull(components, residual, constants);
    let mut change = 0.0;
    for y in 0..height {
        let mut lanes = [0.0_f32; LANES];
        for (c, component) in components.iter_mut().enumerate() {
            for x in 0..width {
                let gradient = match c {
                    0 => residual.x.get(x, y),
                    1 => residual.y.get(x, y),
                    _ => constants.gamma,
                };
                let [along, down] = &component.dual;
                let before = if x > 0 { along.get(x - 1, y) } else { 0.0 };
                let above = if y > 0 { down.get(x, y - 1) } else { 0.0 };
                let divergence = (along.get(x, y) - before) + (down.get(x, y) - above);
                let old = component.value.get(x, y);
                let moved = (old + pull.get(x, y) * gradient) + constants.theta * divergence;
                component.value.set(x, y, moved);
                lanes[x % LANES] += (moved - old) * (moved - old);
            }
        }
        change += lanes.iter().map(|lane| f64::from(*lane)).sum::<f64>();
    }
    for Component { value, dual } in components {
        for y in 0..height {
            for x in 0..width {
                let here = value.get(x, y);
                let gradient_x = value.get((x + 1).min(width - 1), y) - here;
                let gradient_y = value.get(x, (y + 1).min(height - 1)) - here;
                let length = (gradient_x * gradient_x + gradient_y * gradient_y).sqrt();
                let shrink = 1.0 / (1.0 + constants.step * length);
                dual[0].set(x, y, (dual[0].get(x, y) + constants.step * gradient_x) * shrink);
                dual[1].set(x, y, (dual[1].get(x, y) + constants.step * gradient_y) * shrink);
            }
        }
    }
    change
}

/// How far the residual moves each pixel along its gradient: to zero, or as far as the threshold allows.
fn pull(components: &[Component], residual: &Residual, constants: Constants) -> Plane {
    let Size { width, height } = residual.x.size();
    Plane::from_fn(width, height, |x, y| {
        let (along, down) = (residual.x.get(x, y), residual.y.get(x, y));
        let (u, v) = (components[0].value.get(x, y), components[1].value.get(x, y));
        let mut rho = residual.constant.get(x, y) + (along * u + down * v);
        if let Some(brightness) = components.get(2) {
            rho += constants.gamma * brightness.value.get(x, y);
        }
        let square = along * along + down * down;
        let inverse = if square > f32::EPSILON { 1.0 / square } else { INVERSE_OF_NOTHING };
        (-rho * inverse).clamp(-constants.threshold, constants.threshold)
    })
}

/// The median over `side` x `side` pixels.
pub fn median(plane: &Plane, side: usize) -> Plane {
    let Size { width, height } = plane.size();
    let inside = |position: usize, offset: usize, len: usize| {
        (position + offset).saturating_sub(side / 2).min(len - 1)
    };
    Plane::from_fn(width, height, |x, y| {
        let mut window: Vec<f32> = (0..side * side)
            .map(|i| plane.get(inside(x, i % side, width), inside(y, i / side, height)))
            .collect();
        window.sort_by(f32::total_cmp);
        window[window.len() / 2]
    })
}

mod tests {
    use srflow_core::random::Key;

    use super::super::TvL1Parameters;
    use super::super::relaxation::Relaxation;
    use super::super::state::{Layout, State};
    use super::super::warp::Warper;
    use super::*;

    const SIZES: [(usize, usize); 7] = [(1, 1), (1, 30), (40, 1), (3, 3), (16, 9), (53, 31), (131, 64)];

    fn noise(width: usize, height: usize, name: &str, scale: f32) -> Plane {
        let mut random = Key::new(3).stream(name);
        Plane::from_fn(width, height, |_, _| scale * random.normal())
    }

    fn noisy_flow(width: usize, height: usize, scale: f32) -> PlanarFlow {
        PlanarFlow { u: noise(width, height, "u", scale), v: noise(width, height, "v", scale) }
    }

    fn bits(plane: &Plane) -> Vec<u32> {
        plane.pixels().iter().map(|value| value.to_bits()).collect()
    }

    #[test]
    fn the_fast_median_matches() {
        for (width, height) in SIZES {
            let flow = noisy_flow(width, height, 2.0);
            let state = State::new(Layout::new(width, height, false), &flow, None);
            for side in [3, 5] {
                let mut filtered = state.clone();
                super::super::median::filter(&mut filtered, &state, side);
                let (found, _) = filtered.into_planes();
                assert_eq!(bits(&found.u), bits(&median(&flow.u, side)), "{width}x{height}, side {side}");
                assert_eq!(bits(&found.v), bits(&median(&flow.v, side)), "{width}x{height}, side {side}");
            }
        }
    }

    #[test]
    fn the_fast_iterations_match() {
        for (width, height) in SIZES {
            for gamma in [0.0, 0.7] {
                let parameters = TvL1Parameters { gamma, ..TvL1Parameters::default() };
                let constants = Constants::new(&parameters);
                let (first, second) =
                    (noise(width, height, "first", 60.0), noise(width, height, "second", 60.0));
                let flow = noisy_flow(width, height, 3.0);
                let brightness = (gamma > 0.0).then(|| noise(width, height, "brightness", 5.0));

                let residual = linearize(&first, &second, &flow);
                let values = [Some(&flow.u), Some(&flow.v), brightness.as_ref()];
                let mut components: Vec<Component> =
                    values.into_iter().flatten().cloned().map(Component::new).collect();
                let changes: Vec<f64> =
                    (0..37).map(|_| iterate(&mut components, &residual, constants)).collect();

                let layout = Layout::new(width, height, gamma > 0.0);
                let mut relaxation =
                    Relaxation::new(State::new(layout, &flow, brightness.as_ref()), &parameters);
                Warper::new(&second).linearize(&mut relaxation.linearized, &first, &relaxation.state);
                let change = relaxation.run(37, 0.0, f64::INFINITY);
                let (found, found_brightness) = relaxation.state.into_planes();
                let what = format!("{width}x{height}, gamma {gamma}");
                assert_eq!(change.to_bits(), changes[36].to_bits(), "{what}");
                assert_eq!(bits(&found.u), bits(&components[0].value), "u, {what}");
                assert_eq!(bits(&found.v), bits(&components[1].value), "v, {what}");
                if let Some(found) = found_brightness {
                    assert_eq!(bits(&found), bits(&components[2].value), "brightness, {what}");
                }
            }
        }
    }

    #[test]
    fn iterations_stop_when_the_change_falls_below_the_limit() {
        let (width, height) = (70, 50);
        let (first, second) = (noise(width, height, "first", 60.0), noise(width, height, "second", 60.0));
        let flow = noisy_flow(width, height, 0.5);
        let parameters = TvL1Parameters::default();
        let residual = linearize(&first, &second, &flow);
        let mut components = [Component::new(flow.u.clone()), Component::new(flow.v.clone())];
        let mut states = Vec::new();
        for _ in 0..30 {
            let change = iterate(&mut components, &residual, Constants::new(&parameters));
            states.push((change, components[0].value.clone()));
        }
        for end in [0, 1, 2, 3, 7, 12, 29] {
            let limit = states[end].0;
            let ends_there = states[..end].iter().all(|(change, _)| *change > limit);
            assert!(ends_there, "the change does not fall at iteration {end}");
            let state = State::new(Layout::new(width, height, false), &flow, None);
            let mut relaxation = Relaxation::new(state, &parameters);
            Warper::new(&second).linearize(&mut relaxation.linearized, &first, &relaxation.state);
            assert_eq!(relaxation.run(30, limit, f64::INFINITY).to_bits(), limit.to_bits());
            assert_eq!(bits(&relaxation.state.into_planes().0.u), bits(&states[end].1), "end at {end}");
        }
    }
}
