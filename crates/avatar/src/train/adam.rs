//! Adam over the parameters of Gaussians, one pass for each kind: activation, its derivative, moments and update together.

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use srflow_files::FileError;
use srflow_simd::{Isa, Simd, dispatch, exp2};
use srflow_splat::Gaussians;

use super::checkpoint::{Checkpoint, Lists};

/// Gradients of a loss with respect to [`Gaussians`], lists as long as theirs.
#[derive(Debug, Clone, Copy)]
pub struct ParameterGradients<'a> {
    pub positions: &'a [Vec3],
    pub scales: &'a [Vec3],
    pub rotations: &'a [Vec4],
    pub opacities: &'a [f32],
    pub sh: &'a [[f32; 3]],
}

/// How far one step of [`GaussianAdam`] goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearningRates {
    pub positions: f32,
    /// Of the logarithms of scales.
    pub scales: f32,
    pub rotations: f32,
    /// Of the logits of opacities.
    pub opacities: f32,
    /// Of the coefficients of degree 0.
    pub sh_0: f32,
    /// Of the coefficients of higher degrees.
    pub sh_rest: f32,
}

impl Default for LearningRates {
    /// Those at the start of the training of GaussianAvatars (`arguments/__init__.py`); that of positions is meant for a scene of
    /// extent 1.
    fn default() -> Self {
        Self {
            positions: 0.005,
            scales: 0.017,
            rotations: 0.001,
            opacities: 0.05,
            sh_0: 0.0025,
            sh_rest: 0.0025 / 20.0,
        }
    }
}

/// Adam (Kingma and Ba 2015, algorithm 1) as 3D Gaussian Splatting uses it: betas 0.9 and 0.999, epsilon 1e-15; scales move by
/// their logarithms, opacities by their logits, everything else by its own value. Results do not depend on the number of threads
/// or the processor.
#[derive(Debug, Clone)]
pub struct GaussianAdam {
    isa: Isa,
    steps: i32,
    /// Logarithms of the scales.
    log_scales: Vec<f32>,
    /// Logits of the opacities.
    logits: Vec<f32>,
    positions: Moments,
    scales: Moments,
    rotations: Moments,
    opacities: Moments,
    sh: Moments,
}

/// Running means of gradients and of their squares.
#[derive(Debug, Clone)]
pub(super) struct Moments {
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

impl Moments {
    pub(super) fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len] }
    }

    /// Those of the parents, of `each` numbers per Gaussian; zero from Gaussian number `survivors` on.
    fn inherit(&mut self, parents: &[u32], survivors: usize, each: usize) {
        for list in [&mut self.first, &mut self.second] {
            *list = inherited(list, &parents[..survivors], each);
            list.resize(parents.len() * each, 0.0);
        }
    }

    /// More numbers per Gaussian, whose moments are zero.
    fn widen(&mut self, each: usize, wanted: usize) {
        for list in [&mut self.first, &mut self.second] {
            *list = widened(list, each, wanted);
        }
    }
}

/// The entries of the parents, of `each` numbers.
fn inherited<T: Copy>(list: &[T], parents: &[u32], each: usize) -> Vec<T> {
    parents.iter().flat_map(|&parent| &list[parent as usize * each..][..each]).copied().collect()
}

/// Entries of `each` numbers, followed by zeros up to `wanted`.
fn widened<T: Copy + Default>(list: &[T], each: usize, wanted: usize) -> Vec<T> {
    let mut wide = Vec::with_capacity(list.len() / each * wanted);
    for entry in list.chunks(each) {
        wide.extend_from_slice(entry);
        wide.resize(wide.len() + wanted - each, T::default());
    }
    wide
}

pub(super) const BETA_1: f64 = 0.9;
pub(super) const BETA_2: f64 = 0.999;
const EPSILON: f32 = 1e-15;

/// By what a running mean of this decay rate, which starts at zero, is multiplied after so many steps.
pub(super) fn unbiased(beta: f64, steps: i32) -> f64 {
    1.0 / (1.0 - libm::pow(beta, f64::from(steps)))
}

/// Name of the count of steps in checkpoints.
const STEPS: &str = "steps";

/// Numbers in a block: the unit of work of a thread.
const BLOCK: usize = 1 << 14;

impl GaussianAdam {
    /// The state before the first step, for these Gaussians.
    pub fn new(gaussians: &Gaussians) -> Self {
        let n = gaussians.len();
        let scales = gaussians.scales.iter().flat_map(|scale| scale.to_array());
        Self {
            isa: Isa::best(),
            steps: 0,
            log_scales: scales.map(log_of_scale).collect(),
            logits: gaussians.opacities.iter().map(|&opacity| logit(opacity)).collect(),
            positions: Moments::new(3 * n),
            scales: Moments::new(3 * n),
            rotations: Moments::new(4 * n),
            opacities: Moments::new(n),
            sh: Moments::new(3 * gaussians.sh.len()),
        }
    }

    /// Moves `gaussians` by one step against `gradients`.
    ///
    /// Panics when a list has another length than those of the Gaussians that this was created for.
    pub fn step(
        &mut self,
        gaussians: &mut Gaussians,
        gradients: ParameterGradients<'_>,
        rates: &LearningRates,
    ) {
        self.steps += 1;
        let constants = Constants {
            step: unbiased(BETA_1, self.steps) as f32,
            root: (1.0 / libm::sqrt(1.0 - libm::pow(BETA_2, f64::from(self.steps)))) as f32,
        };
        let isa = self.isa;
        let same = |rate: f32| vec![rate; BLOCK];
        let own = Link::Identity;
        let values: &mut [f32] = bytemuck::cast_slice_mut(&mut gaussians.positions);
        let slopes = bytemuck::cast_slice(gradients.positions);
        update(isa, own, constants, &same(rates.positions), values, &mut [], slopes, &mut self.positions);
        let values = bytemuck::cast_slice_mut(&mut gaussians.scales);
        let slopes = bytemuck::cast_slice(gradients.scales);
        let raw = &mut self.log_scales;
        update(isa, Link::Exp, constants, &same(rates.scales), values, raw, slopes, &mut self.scales);
        let values = bytemuck::cast_slice_mut(&mut gaussians.rotations);
        let slopes = bytemuck::cast_slice(gradients.rotations);
        update(isa, own, constants, &same(rates.rotations), values, &mut [], slopes, &mut self.rotations);
        let (values, slopes) = (&mut gaussians.opacities, gradients.opacities);
        let (raw, moments) = (&mut self.logits, &mut self.opacities);
        update(isa, Link::Sigmoid, constants, &same(rates.opacities), values, raw, slopes, moments);
        let each = 3 * gaussians.sh_len();
        let block = (BLOCK / each).max(1) * each;
        let sh_rates: Vec<f32> =
            (0..block).map(|i| if i % each < 3 { rates.sh_0 } else { rates.sh_rest }).collect();
        let (values, slopes) = (gaussians.sh.as_flattened_mut(), gradients.sh.as_flattened());
        update(isa, own, constants, &sh_rates, values, &mut [], slopes, &mut self.sh);
    }
}

impl GaussianAdam {
    fn lists_mut(&mut self) -> [(&'static str, &mut Vec<f32>); 12] {
        let Self { isa: _, steps: _, log_scales, logits, positions, scales, rotations, opacities, sh } = self;
        [
            ("log_scales", log_scales),
            ("logits", logits),
            ("mean_positions", &mut positions.first),
            ("mean_scales", &mut scales.first),
            ("mean_rotations", &mut rotations.first),
            ("mean_opacities", &mut opacities.first),
            ("mean_sh", &mut sh.first),
            ("square_positions", &mut positions.second),
            ("square_scales", &mut scales.second),
            ("square_rotations", &mut rotations.second),
            ("square_opacities", &mut opacities.second),
            ("square_sh", &mut sh.second),
        ]
    }

    /// The state of a checkpoint, for these Gaussians.
    ///
    /// # Errors
    /// When a list is missing or has another length.
    pub(super) fn load(gaussians: &Gaussians, checkpoint: &mut Checkpoint) -> Result<Self, FileError> {
        let mut adam = Self::new(gaussians);
        for (name, list) in adam.lists_mut() {
            *list = checkpoint.list(name, Some(list.len()))?;
        }
        adam.steps = checkpoint.counts(STEPS, Some(1))?[0] as i32;
        Ok(adam)
    }

    /// Every list of a checkpoint, by name.
    pub(super) fn lists(&self) -> Lists {
        let mut copy = self.clone();
        let lists = copy.lists_mut().map(|(name, list)| (name, std::mem::take(list)));
        lists.into_iter().chain([(STEPS, vec![self.steps as f32])]).collect()
    }

    /// Replaces the `gaussians` by copies of their `parents`, given by number. The first `survivors` keep their moments; those of
    /// the others start at zero, with the count of steps that all share, as in 3D Gaussian Splatting.
    ///
    /// Panics when a parent does not exist.
    pub(crate) fn inherit(&mut self, gaussians: &mut Gaussians, parents: &[u32], survivors: usize) {
        let sh_len = gaussians.sh_len();
        gaussians.positions = inherited(&gaussians.positions, parents, 1);
        gaussians.scales = inherited(&gaussians.scales, parents, 1);
        gaussians.rotations = inherited(&gaussians.rotations, parents, 1);
        gaussians.opacities = inherited(&gaussians.opacities, parents, 1);
        gaussians.sh = inherited(&gaussians.sh, parents, sh_len);
        self.log_scales = inherited(&self.log_scales, parents, 3);
        self.logits = inherited(&self.logits, parents, 1);
        self.positions.inherit(parents, survivors, 3);
        self.scales.inherit(parents, survivors, 3);
        self.rotations.inherit(parents, survivors, 4);
        self.opacities.inherit(parents, survivors, 1);
        self.sh.inherit(parents, survivors, 3 * sh_len);
    }

    /// Sets the scale of Gaussian number `at`.
    pub(crate) fn set_scale(&mut self, gaussians: &mut Gaussians, at: usize, scale: Vec3) {
        gaussians.scales[at] = scale;
        self.log_scales[3 * at..][..3].copy_from_slice(&scale.to_array().map(log_of_scale));
    }

    /// Sets the opacity of Gaussian number `at`.
    pub(crate) fn set_opacity(&mut self, gaussians: &mut Gaussians, at: usize, opacity: f32) {
        gaussians.opacities[at] = opacity;
        self.logits[at] = logit(opacity);
    }

    /// Lowers every opacity to `most`, and forgets the moments of all opacities: the reset of 3D Gaussian Splatting.
    pub(crate) fn reset_opacities(&mut self, gaussians: &mut Gaussians, most: f32) {
        let limit = logit(most);
        for (opacity, raw) in gaussians.opacities.iter_mut().zip(&mut self.logits) {
            if *raw > limit {
                (*opacity, *raw) = (most, limit);
            }
        }
        self.opacities = Moments::new(gaussians.len());
    }

    /// Raises the degree of the spherical harmonics. New coefficients and their moments are zero, as if they had been there from
    /// the start without being drawn.
    pub(crate) fn raise_sh_degree(&mut self, gaussians: &mut Gaussians, degree: usize) {
        let before = gaussians.sh_len();
        gaussians.sh_degree = degree;
        let after = gaussians.sh_len();
        gaussians.sh = widened(&gaussians.sh, before, after);
        self.sh.widen(3 * before, 3 * after);
    }
}

fn log_of_scale(scale: f32) -> f32 {
    // A scale of zero would never move again.
    libm::logf(scale.max(1e-20))
}

/// The number whose logistic function is `opacity`; finite for any opacity.
fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity).clamp(1e-7, 1.0 - 1e-7);
    libm::log(opacity / (1.0 - opacity)) as f32
}

/// What makes a value out of the number that is optimized.
#[derive(Clone, Copy, PartialEq)]
enum Link {
    Identity,
    Exp,
    Sigmoid,
}

/// Corrections for the moments' start at zero.
#[derive(Clone, Copy)]
struct Constants {
    step: f32,
    root: f32,
}

/// Updates one kind of parameters, in parallel. `rates` are those of one block of numbers, and the same for each; `raw` are the
/// numbers that are optimized, empty for the values themselves.
#[expect(clippy::too_many_arguments, reason = "the lists that one update reads and writes")]
fn update(
    isa: Isa,
    link: Link,
    constants: Constants,
    rates: &[f32],
    values: &mut [f32],
    raw: &mut [f32],
    gradients: &[f32],
    moments: &mut Moments,
) {
    let Moments { first, second } = moments;
    let lengths =
        [values.len(), gradients.len(), if link == Link::Identity { first.len() } else { raw.len() }];
    assert_eq!(lengths, [first.len(); 3], "lists of another number of Gaussians");
    let mut raw = raw.chunks_mut(rates.len());
    let blocks: Vec<Block<'_>> = values
        .chunks_mut(rates.len())
        .zip(gradients.chunks(rates.len()))
        .zip(first.chunks_mut(rates.len()).zip(second.chunks_mut(rates.len())))
        .map(|((values, gradients), (first, second))| Block {
            values,
            raw: raw.next().unwrap_or_default(),
            gradients,
            first,
            second,
        })
        .collect();
    blocks.into_par_iter().for_each(|block| update_block(isa, link, constants, rates, block));
}

/// A part of the lists of one kind of parameters.
struct Block<'a> {
    values: &'a mut [f32],
    raw: &'a mut [f32],
    gradients: &'a [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

dispatch! {
    fn update_block = update_block_kernel(link: Link, constants: Constants, rates: &[f32], block: Block<'_>)
}

#[inline(always)]
fn update_block_kernel<S: Simd>(s: S, link: Link, constants: Constants, rates: &[f32], block: Block<'_>) {
    match link {
        Link::Identity => update_kernel(s, Link::Identity, constants, rates, block),
        Link::Exp => update_kernel(s, Link::Exp, constants, rates, block),
        Link::Sigmoid => update_kernel(s, Link::Sigmoid, constants, rates, block),
    }
}

#[inline(always)]
fn update_kernel<S: Simd>(s: S, link: Link, constants: Constants, rates: &[f32], block: Block<'_>) {
    let Block { values, raw, gradients, first, second } = block;
    let constant = |x: f64| s.splat(x as f32);
    let one = s.splat(1.0);
    for at in (0..values.len()).step_by(S::LANES) {
        let end = values.len().min(at + S::LANES);
        let value = s.read_first(&values[at..end]);
        let gradient = s.read_first(&gradients[at..end]);
        let gradient = match link {
            Link::Identity => gradient,
            Link::Exp => s.mul(gradient, value),
            Link::Sigmoid => s.mul(gradient, s.mul(value, s.sub(one, value))),
        };
        let mean = s.mul(constant(BETA_1), s.read_first(&first[at..end]));
        let mean = s.mul_add(constant(1.0 - BETA_1), gradient, mean);
        let square = s.mul(constant(BETA_2), s.read_first(&second[at..end]));
        let square = s.mul_add(constant(1.0 - BETA_2), s.mul(gradient, gradient), square);
        s.write_first(mean, &mut first[at..end]);
        s.write_first(square, &mut second[at..end]);
        let size = s.mul_add(s.sqrt(square), s.splat(constants.root), s.splat(EPSILON));
        let length = s.mul(s.read_first(&rates[at..end]), s.splat(constants.step));
        let change = s.div(s.mul(length, mean), size);
        if link == Link::Identity {
            s.write_first(s.sub(value, change), &mut values[at..end]);
            continue;
        }
        // Within what exp2 can take, and far beyond any use.
        let limit = s.splat(60.0);
        let moved = s.sub(s.read_first(&raw[at..end]), change);
        let moved = s.max(s.sub(s.splat(0.0), limit), s.min(limit, moved));
        s.write_first(moved, &mut raw[at..end]);
        let exponent = s.mul(moved, s.splat(std::f32::consts::LOG2_E));
        let value = if link == Link::Exp {
            exp2(s, exponent)
        } else {
            s.div(one, s.add(one, exp2(s, s.sub(s.splat(0.0), exponent))))
        };
        s.write_first(value, &mut values[at..end]);
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use srflow_core::random::{Key, Stream};

    use super::*;

    fn gaussians(count: usize, stream: &mut Stream) -> Gaussians {
        let mut vector = || Vec3::new(stream.normal(), stream.normal(), stream.normal());
        Gaussians {
            positions: (0..count).map(|_| vector()).collect(),
            scales: (0..count).map(|_| vector().abs() + 0.01).collect(),
            rotations: (0..count).map(|_| Quat::from_scaled_axis(vector())).collect(),
            opacities: (0..count).map(|_| vector().x.abs().min(1.0)).collect(),
            sh_degree: 1,
            sh: (0..4 * count).map(|_| vector().to_array()).collect(),
            antialiased: false,
        }
    }

    /// Random gradients, a tenth of them zero.
    struct Slopes(Gaussians);

    impl Slopes {
        fn new(count: usize, stream: &mut Stream) -> Self {
            let mut slopes = gaussians(count, stream);
            for i in (0..count).step_by(10) {
                (slopes.positions[i], slopes.opacities[i]) = (Vec3::ZERO, 0.0);
            }
            Self(slopes)
        }

        fn rotations(&self) -> Vec<Vec4> {
            self.0.rotations.iter().map(|&rotation| Vec4::from(rotation)).collect()
        }

        fn lists<'a>(&'a self, rotations: &'a [Vec4]) -> ParameterGradients<'a> {
            let Gaussians { positions, scales, opacities, sh, .. } = &self.0;
            ParameterGradients { positions, scales, rotations, opacities, sh }
        }
    }

    /// Algorithm 1 of the paper for one number, in `f64`.
    #[derive(Default, Clone, Copy)]
    struct Number {
        mean: f64,
        square: f64,
        steps: i32,
    }

    impl Number {
        fn change(&mut self, gradient: f64, rate: f64) -> f64 {
            self.steps += 1;
            self.mean = 0.9 * self.mean + 0.1 * gradient;
            self.square = 0.999 * self.square + 0.001 * gradient * gradient;
            let mean = self.mean / (1.0 - 0.9_f64.powi(self.steps));
            let square = self.square / (1.0 - 0.999_f64.powi(self.steps));
            rate * mean / (square.sqrt() + 1e-15)
        }
    }

    #[test]
    fn steps_are_those_of_the_paper() {
        let mut stream = Key::new(8).stream("adam");
        let start = gaussians(23, &mut stream);
        let mut found = start.clone();
        let mut adam = GaussianAdam::new(&found);
        let rates = LearningRates::default();
        let mut numbers = vec![[Number::default(); 6]; 23];
        let mut position = f64::from(start.positions[7].y);
        let mut log_scale = f64::from(start.scales[7].z).ln();
        let mut quaternion = f64::from(start.rotations[7].w);
        let mut logit = (f64::from(start.opacities[7]) / (1.0 - f64::from(start.opacities[7]))).ln();
        let (mut color, mut rest) = (f64::from(start.sh[28][1]), f64::from(start.sh[30][2]));
        for _ in 0..30 {
            let slopes = Slopes::new(23, &mut stream);
            adam.step(&mut found, slopes.lists(&slopes.rotations()), &rates);
            let [p, s, q, o, c, r] = &mut numbers[7];
            let slopes = slopes.0;
            position -= p.change(f64::from(slopes.positions[7].y), 0.005);
            log_scale -= s.change(f64::from(slopes.scales[7].z) * log_scale.exp(), 0.017);
            quaternion -= q.change(f64::from(slopes.rotations[7].w), 0.001);
            let opacity = 1.0 / (1.0 + (-logit).exp());
            logit -= o.change(f64::from(slopes.opacities[7]) * opacity * (1.0 - opacity), 0.05);
            color -= c.change(f64::from(slopes.sh[28][1]), 0.0025);
            rest -= r.change(f64::from(slopes.sh[30][2]), 0.000125);
        }
        let opacity = 1.0 / (1.0 + (-logit).exp());
        let close = |found: f32, expected: f64| {
            assert!(
                (f64::from(found) - expected).abs() < 2e-5 * (1.0 + expected.abs()),
                "{found}, {expected}"
            );
        };
        close(found.positions[7].y, position);
        close(found.scales[7].z, log_scale.exp());
        close(found.rotations[7].w, quaternion);
        close(found.opacities[7], opacity);
        close(found.sh[28][1], color);
        close(found.sh[30][2], rest);
    }

    #[test]
    fn steps_have_the_same_bits_on_every_processor_and_number_of_threads() {
        let run = |isa: Isa, threads: usize| {
            let mut stream = Key::new(9).stream("adam");
            let mut found = gaussians(9001, &mut stream);
            let mut adam = GaussianAdam { isa, ..GaussianAdam::new(&found) };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for _ in 0..3 {
                let slopes = Slopes::new(9001, &mut stream);
                let rotations = slopes.rotations();
                pool.install(|| adam.step(&mut found, slopes.lists(&rotations), &LearningRates::default()));
            }
            found
        };
        let expected = run(Isa::best(), 1);
        for isa in Isa::to_test() {
            for threads in [1, 2, 5] {
                assert!(run(isa, threads) == expected, "{isa:?}, {threads} threads");
            }
        }
    }

    #[test]
    fn parameters_stay_in_their_range_under_steep_gradients() {
        let mut stream = Key::new(10).stream("adam");
        let mut found = gaussians(40, &mut stream);
        found.scales[0] = Vec3::ZERO;
        (found.opacities[1], found.opacities[2]) = (0.0, 1.0);
        let mut adam = GaussianAdam::new(&found);
        let rates = LearningRates { scales: 10.0, opacities: 10.0, ..LearningRates::default() };
        for _ in 0..50 {
            let mut slopes = Slopes::new(40, &mut stream);
            slopes.0.opacities.iter_mut().for_each(|slope| *slope *= 1e15);
            slopes.0.scales.iter_mut().step_by(2).for_each(|slope| *slope *= -1e15);
            adam.step(&mut found, slopes.lists(&slopes.rotations()), &rates);
        }
        assert!(found.scales.iter().all(|scale| scale.is_finite() && scale.cmpgt(Vec3::ZERO).all()));
        assert!(found.opacities.iter().all(|opacity| (0.0..=1.0).contains(opacity)));
    }

    /// Copies move like their parents as long as the moments are the same, and from the first step on otherwise than a parent with
    /// moments where they are not.
    #[test]
    fn survivors_keep_their_moments_and_others_start_without() {
        let mut stream = Key::new(11).stream("adam");
        let mut whole = gaussians(6, &mut stream);
        let mut adam = GaussianAdam::new(&whole);
        let rates = LearningRates::default();
        for _ in 0..3 {
            let slopes = Slopes::new(6, &mut stream);
            adam.step(&mut whole, slopes.lists(&slopes.rotations()), &rates);
        }
        let (mut part, mut part_adam) = (whole.clone(), adam.clone());
        part_adam.inherit(&mut part, &[4, 1, 1], 2);
        assert_eq!(part.positions, [whole.positions[4], whole.positions[1], whole.positions[1]]);
        assert_eq!(part.sh[8..], whole.sh[4..8]);
        let slopes = Slopes::new(6, &mut stream);
        adam.step(&mut whole, slopes.lists(&slopes.rotations()), &rates);
        let mut chosen = slopes.0;
        GaussianAdam::new(&chosen.clone()).inherit(&mut chosen, &[4, 1, 1], 0);
        let chosen = Slopes(chosen);
        part_adam.step(&mut part, chosen.lists(&chosen.rotations()), &rates);
        for (i, parent) in [4, 1].into_iter().enumerate() {
            assert_eq!(part.positions[i], whole.positions[parent]);
            assert_eq!(part.scales[i], whole.scales[parent]);
            assert_eq!(part.opacities[i], whole.opacities[parent]);
            assert_eq!(part.sh[4 * i..][..4], whole.sh[4 * parent..][..4]);
        }
        assert_ne!(part.positions[2], whole.positions[1], "without its parent's moments");
        assert!(part_adam.opacities.first[2] != 0.0 && part_adam.opacities.first.len() == 3);
    }

    #[test]
    fn a_reset_lowers_opacities_and_forgets_their_moments() {
        let mut stream = Key::new(12).stream("adam");
        let mut found = gaussians(9, &mut stream);
        found.opacities[3] = 0.002;
        let mut adam = GaussianAdam::new(&found);
        let slopes = Slopes::new(9, &mut stream);
        adam.step(&mut found, slopes.lists(&slopes.rotations()), &LearningRates::default());
        let before = found.clone();
        adam.reset_opacities(&mut found, 0.01);
        assert!(found.opacities.iter().all(|&opacity| opacity <= 0.01));
        assert_eq!(found.opacities[3], before.opacities[3], "a lower one stays");
        assert!(adam.opacities.first.iter().chain(&adam.opacities.second).all(|moment| *moment == 0.0));
        // Only opacities were touched, and the next step starts from the value that is shown.
        assert_eq!(Gaussians { opacities: before.opacities.clone(), ..found.clone() }, before);
        let rates = LearningRates { opacities: 0.0, ..LearningRates::default() };
        let shown = found.opacities.clone();
        adam.step(&mut found, slopes.lists(&slopes.rotations()), &rates);
        assert!(found.opacities.iter().zip(&shown).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    /// The reference trains with all coefficients from the start, of which the higher ones have no gradient at first.
    #[test]
    fn a_higher_degree_moves_as_if_it_had_been_there() {
        let mut stream = Key::new(13).stream("adam");
        let mut low = gaussians(5, &mut stream);
        let mut low_adam = GaussianAdam::new(&low);
        let (mut high, mut high_adam) = (low.clone(), low_adam.clone());
        high_adam.raise_sh_degree(&mut high, 2);
        assert_eq!((high.sh_len(), high.sh.len()), (9, 45));
        for step in 0..4 {
            let slopes = Slopes::new(5, &mut stream);
            let rotations = slopes.rotations();
            let mut wide = slopes.0.clone();
            GaussianAdam::new(&wide.clone()).raise_sh_degree(&mut wide, 2);
            let wide = Slopes(wide);
            if step < 3 {
                low_adam.step(&mut low, slopes.lists(&rotations), &LearningRates::default());
            } else {
                low_adam.raise_sh_degree(&mut low, 2);
                low_adam.step(&mut low, wide.lists(&rotations), &LearningRates::default());
            }
            high_adam.step(&mut high, wide.lists(&rotations), &LearningRates::default());
        }
        assert_eq!(low, high);
    }
}
