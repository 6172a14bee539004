//! The two kernels of the method as plain scalar code: what the fast ones must compute.

use srflow_field::Plane;

use super::Window;
use super::expansion::{ExpansionKernel, Polynomial};
use crate::planar::PlanarFlow;

/// Near the image's border the evidence counts less: the weight of a pixel by its distance to the border.
const BORDER_WEIGHTS: [f32; 5] = [0.14, 0.14, 0.4472, 0.4472, 0.4472];

/// The fit at every pixel of `image`, row-major. Outside the image its border pixels are repeated.
pub fn expand(image: &Plane, kernel: &ExpansionKernel) -> Vec<Polynomial> {
    let (width, height) = image.size();
    let radius = kernel.g.len() - 1;
    let inverse = &kernel.inverse;
    let mut polynomials = Vec::with_capacity(width * height);
    for y in 0..height {
        // Moments down the column: of 1, of y and of y^2.
        let down: Vec<[f32; 3]> = (0..width)
            .map(|x| {
                let mut moments = [image.get(x, y) * kernel.g[0][0], 0.0, 0.0];
                for (k, g) in (1..).zip(&kernel.g[1..]) {
                    let (above, below) =
                        (image.get(x, y.saturating_sub(k)), image.get(x, (y + k).min(height - 1)));
                    moments[0] += g[0] * (above + below);
                    moments[1] += g[1] * (below - above);
                    moments[2] += g[2] * (above + below);
                }
                moments
            })
            .collect();
        for x in 0..width {
            let [mut one, mut of_y, mut of_yy] = down[x].map(|moment| moment * kernel.g[0][0]);
            let [mut of_x, mut of_xx, mut of_xy] = [0.0; 3];
            for (k, g) in (1..=radius).zip(&kernel.g[1..]) {
                let (left, right) = (down[x.saturating_sub(k)], down[(x + k).min(width - 1)]);
                one += g[0] * (left[0] + right[0]);
                of_x += g[1] * (right[0] - left[0]);
                of_xx += g[2] * (left[0] + right[0]);
                of_y += g[0] * (left[1] + right[1]);
                of_xy += g[1] * (right[1] - left[1]);
                of_yy += g[0] * (left[2] + right[2]);
            }
            polynomials.push(Polynomial {
                x: of_x * inverse.linear,
                y: of_y * inverse.linear,
                xx: one * inverse.constant_square + of_xx * inverse.square,
                yy: one * inverse.constant_square + of_yy * inverse.square,
                xy: of_xy * inverse.mixed,
            });
        }
    }
    polynomials
}

/// What one pixel says of its displacement: the normal equations `G d = h`, as `[g_xx, g_xy, g_yy, h_x, h_y]`.
type Evidence = [f32; 5];

/// One iteration: a new flow from the expansions of both frames and the flow so far.
pub fn update(first: &[Polynomial], second: &[Polynomial], flow: &PlanarFlow, window: &Window) -> PlanarFlow {
    let (width, height) = flow.u.size();
    let evidence: Vec<Evidence> = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let displacement = [flow.u.get(x, y), flow.v.get(x, y)];
            let weight = border_weight(x, width) * border_weight(y, height);
            gather_evidence(first[i], second, (width, height), (x, y), displacement, weight)
        })
        .collect();

    let radius = window.weights.len() - 1;
    let blend = |at: &dyn Fn(usize) -> [f64; 5], centre: usize, len: usize| {
        let mut sum = at(centre).map(|e| e * f64::from(window.weights[0]));
        for k in 1..=radius {
            let (before, after) = (at(centre.saturating_sub(k)), at((centre + k).min(len - 1)));
            for channel in 0..5 {
                sum[channel] += f64::from(window.weights[k]) * (before[channel] + after[channel]);
            }
        }
        sum
    };
    let down: Vec<[f64; 5]> = (0..width * height)
        .map(|i| blend(&|y| evidence[y * width + i % width].map(f64::from), i / width, height))
        .collect();
    let mut updated = PlanarFlow::zero(width, height);
    for y in 0..height {
        for x in 0..width {
            let [u, v] = solve(blend(&|x| down[y * width + x], x, width));
            updated.u.set(x, y, u);
            updated.v.set(x, y, v);
        }
    }
    updated
}

fn border_weight(position: usize, len: usize) -> f32 {
    let weight = |distance: usize| BORDER_WEIGHTS.get(distance).copied().unwrap_or(1.0);
    weight(position) * weight(len - 1 - position)
}

/// Compares the fit at a pixel of the first frame with the fit of the second frame where the flow leads.
fn gather_evidence(
    p: Polynomial,
    second: &[Polynomial],
    (width, height): (usize, usize),
    (x, y): (usize, usize),
    [u, v]: [f32; 2],
    weight: f32,
) -> Evidence {
    let (target_x, target_y) = (x as f32 + u, y as f32 + v);
    let (left, top) = (target_x.floor(), target_y.floor());
    let inside = left >= 0.0 && top >= 0.0 && left + 1.0 < width as f32 && top + 1.0 < height as f32;

    // The mean of both quadratic parts, and half the difference of the linear parts. `xy` is halved once more,
    // since the matrix holds it twice.
    let [mut xx, mut yy, mut xy, mut dx, mut dy] = [p.xx, p.yy, p.xy * 0.5, p.x * 0.5, p.y * 0.5];
    if inside {
        let (fx, fy) = (target_x - left, target_y - top);
        let at = top as usize * width + left as usize;
        let corners = [second[at], second[at + 1], second[at + width], second[at + width + 1]];
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let lerp = |get: fn(&Polynomial) -> f32| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| weights[i] * get(&corners[i]));
            a + b + c + d
        };
        xx = (p.xx + lerp(|q| q.xx)) * 0.5;
        yy = (p.yy + lerp(|q| q.yy)) * 0.5;
        xy = (p.xy + lerp(|q| q.xy)) * 0.25;
        dx = (p.x - lerp(|q| q.x)) * 0.5;
        dy = (p.y - lerp(|q| q.y)) * 0.5;
    }
    dx += xx * u + xy * v;
    dy += yy * v + xy * u;
    let [xx, yy, xy, dx, dy] = [xx, yy, xy, dx, dy].map(|value| value * weight);
    [xx * xx + xy * xy, (xx + yy) * xy, yy * yy + xy * xy, xx * dx + xy * dy, xy * dx + yy * dy]
}

/// `d` of `G d = h`, with a little added to the determinant where there is no texture.
fn solve([g_xx, g_xy, g_yy, h_x, h_y]: [f64; 5]) -> [f32; 2] {
    let inverse = 1.0 / (g_xx * g_yy - g_xy * g_xy + 1e-3);
    [((g_yy * h_x - g_xy * h_y) * inverse) as f32, ((g_xx * h_y - g_xy * h_x) * inverse) as f32]
}
