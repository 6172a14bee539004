//! Averaging evidence over the window around each pixel.

use super::evidence::{CHANNELS, EvidenceRows};
use srflow_simd::multiversioned;

/// The window that evidence is averaged over: `2 * radius + 1` pixels a side.
#[derive(Debug, Clone)]
pub struct Window {
    pub radius: usize,
    pub weighting: Weighting,
}

#[derive(Debug, Clone)]
pub enum Weighting {
    /// Uniform weights; the sum is multiplied by `scale`.
    Box { scale: f64 },
    /// Weights by the distance along one axis, from 0 to the radius.
    Gaussian { weights: Vec<f32> },
}

impl Window {
    pub fn new(winsize: usize, gaussian: bool) -> Self {
        let radius = winsize / 2;
        if !gaussian {
            return Self { radius, weighting: Weighting::Box { scale: 1.0 / (winsize * winsize) as f64 } };
        }
        let sigma = radius as f64 * 0.3;
        let weight = |k: usize| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma)) as f32;
        let sum = 1.0 + 2.0 * (1..=radius).map(|k| f64::from(weight(k))).sum::<f64>();
        let normalised = |k: usize| if k == 0 { 1.0 / sum } else { f64::from(weight(k)) * (1.0 / sum) };
        let weights = (0..=radius).map(|k| normalised(k) as f32).collect();
        Self { radius, weighting: Weighting::Gaussian { weights } }
    }
}

/// Averages one strip's evidence row by row, downwards from the first.
pub struct Averager {
    window: Window,
    /// Box: sums down each column of the rows in the window.
    sums: Vec<f64>,
    /// Gaussian: weighted sums down each column.
    weighted: Vec<f32>,
    padded_sums: Vec<f64>,
    padded_weighted: Vec<f32>,
    power_sums: PowerSums,
    average: Vec<f32>,
}

impl Averager {
    pub fn new(window: &Window) -> Self {
        Self {
            window: window.clone(),
            sums: Vec::new(),
            weighted: Vec::new(),
            padded_sums: Vec::new(),
            padded_weighted: Vec::new(),
            power_sums: PowerSums::default(),
            average: Vec::new(),
        }
    }

    /// Writes the average of row `y` to `out`, one run of the strip's width per channel. Rows must be requested in order.
    pub fn average(&mut self, out: &mut [f64], rows: &EvidenceRows, y: usize) {
        let radius = self.window.radius;
        match &self.window.weighting {
            Weighting::Box { scale } => {
                if y == 0 {
                    start_sums(&mut self.sums, rows, radius);
                }
                slide_down(&mut self.sums, rows.row(y + radius), rows.row(y.saturating_sub(radius + 1)));
                for (out, sums) in
                    out.chunks_exact_mut(out.len() / CHANNELS).zip(self.sums.chunks_exact(rows.run))
                {
                    rows.pad(&mut self.padded_sums, sums);
                    box_sums(out, &self.padded_sums, 2 * radius + 1, &mut self.power_sums);
                    multiply(out, *scale);
                }
            }
            Weighting::Gaussian { weights } => {
                self.weighted.resize(rows.run * CHANNELS, 0.0);
                start_weighted(&mut self.weighted, rows.row(y), weights[0]);
                for (k, weight) in (1..).zip(&weights[1..]) {
                    let (above, below) = (rows.row(y.saturating_sub(k)), rows.row(y + k));
                    add_weighted(&mut self.weighted, above, below, *weight);
                }
                for (out, column) in
                    out.chunks_exact_mut(out.len() / CHANNELS).zip(self.weighted.chunks_exact(rows.run))
                {
                    rows.pad(&mut self.padded_weighted, column);
                    let padded = &self.padded_weighted;
                    self.average.resize(out.len(), 0.0);
                    start_weighted(&mut self.average, &padded[radius..], weights[0]);
                    for (k, weight) in (1..).zip(&weights[1..]) {
                        add_weighted(
                            &mut self.average,
                            &padded[radius - k..],
                            &padded[radius + k..],
                            *weight,
                        );
                    }
                    for (out, average) in out.iter_mut().zip(&self.average) {
                        *out = f64::from(*average);
                    }
                }
            }
        }
    }
}

/// The sums from which [`slide_down`] computes those of the first row, whose window repeats that row in its upper half.
fn start_sums(sums: &mut Vec<f64>, rows: &EvidenceRows, radius: usize) {
    sums.clear();
    sums.extend(rows.row(0).iter().map(|evidence| f64::from(evidence * (radius + 2) as f32)));
    for y in 1..radius {
        for (sum, evidence) in sums.iter_mut().zip(rows.row(y)) {
            *sum += f64::from(*evidence);
        }
    }
}

multiversioned! {
    /// Rounds the difference to single precision before adding it, as OpenCV does.
    fn slide_down(sums: &mut [f64], added: &[f32], removed: &[f32]) {
        for ((sum, added), removed) in sums.iter_mut().zip(added).zip(removed) {
            *sum += f64::from(added - removed);
        }
    }
}

/// Scratch space of [`box_sums`].
#[derive(Debug, Clone, Default)]
struct PowerSums {
    current: Vec<f64>,
    doubled: Vec<f64>,
}

/// Sets `out[i]` to the sum of `len` values from `values[i]` on. Sums of 2, 4, 8... values are built from one another, and
/// the sum of `len` from those of its binary digits: few additions, all independent of their neighbours.
fn box_sums(out: &mut [f64], values: &[f64], len: usize, room: &mut PowerSums) {
    room.current.clear();
    room.current.extend_from_slice(values);
    room.doubled.resize(values.len(), 0.0);
    let (mut power, mut covered) = (1, 0);
    loop {
        if len & power != 0 {
            let higher_digits = len - covered - power;
            let part = &room.current[higher_digits..higher_digits + out.len()];
            if covered == 0 {
                out.copy_from_slice(part)
            } else {
                add(out, part)
            }
            covered += power;
        }
        if covered == len {
            return;
        }
        double(&mut room.doubled, &room.current, power);
        std::mem::swap(&mut room.current, &mut room.doubled);
        power *= 2;
    }
}

multiversioned! {
    fn add(out: &mut [f64], part: &[f64]) {
        for (out, part) in out.iter_mut().zip(part) {
            *out += part;
        }
    }
}

multiversioned! {
    fn double(doubled: &mut [f64], current: &[f64], power: usize) {
        for ((out, near), far) in doubled.iter_mut().zip(current).zip(&current[power..]) {
            *out = near + far;
        }
    }
}

multiversioned! {
    fn multiply(out: &mut [f64], scale: f64) {
        for out in out {
            *out *= scale;
        }
    }
}

multiversioned! {
    fn start_weighted(out: &mut [f32], centre: &[f32], weight: f32) {
        for (out, centre) in out.iter_mut().zip(centre) {
            *out = centre * weight;
        }
    }
}

multiversioned! {
    fn add_weighted(out: &mut [f32], before: &[f32], after: &[f32], weight: f32) {
        for ((out, before), after) in out.iter_mut().zip(before).zip(after) {
            *out += (before + after) * weight;
        }
    }
}
