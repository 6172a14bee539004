//! The same by a backend's own operations.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;

use super::PARTS;
use super::tensor::NegativeLogLikelihood;
use crate::operation::{Backprop, Composition, narrow};

impl Composition<3> for NegativeLogLikelihood {
    fn composed<B: Backend>(
        &self,
        [difference, log_weights, log_scales]: [FloatTensor<B>; 3],
    ) -> Vec<FloatTensor<B>> {
        let weights = parts::<B>(&log_weights);
        let densities = self.log_densities::<B>(&difference, &weights, &self.limited::<B>(&log_scales));
        vec![B::float_sub(log_sum_exp::<B>(&weights), log_sum_exp::<B>(&densities))]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        let ([difference, log_weights, log_scales], grad) = back.into_parts();
        let weights = parts::<B>(&log_weights);
        let limited = self.limited::<B>(&log_scales);
        let shares = softmax::<B>(&weights);
        let likely = softmax::<B>(&self.log_densities::<B>(&difference, &weights, &limited));
        let distance = B::float_abs(difference.clone());
        let over_scale =
            |x: FloatTensor<B>, k: usize| B::float_mul(x, B::float_exp(B::float_neg(limited[k].clone())));
        let weighted = |x: FloatTensor<B>| B::float_mul(x, grad.clone());
        let of_weights = (0..PARTS)
            .map(|k| B::float_sum_dim(weighted(B::float_sub(shares[k].clone(), likely[k].clone())), 1));
        let of_scales = (0..PARTS).map(|k| {
            let one_less = B::float_add_scalar(B::float_neg(over_scale(distance.clone(), k)), 1.0.into());
            let slope = B::float_sum_dim(weighted(B::float_mul(likely[k].clone(), one_less)), 1);
            // 1 within the range and 0 outside: the sign of the distance from the limited one.
            let given = &parts::<B>(&log_scales)[k];
            let cut = B::float_abs(B::float_sign(B::float_sub(given.clone(), limited[k].clone())));
            B::float_mul(slope, B::float_add_scalar(B::float_neg(cut), 1.0.into()))
        });
        let slope = B::float_add(over_scale(likely[0].clone(), 0), over_scale(likely[1].clone(), 1));
        let of_difference = weighted(B::float_mul(slope, B::float_sign(difference)));
        let [of_weights, of_scales] =
            [of_weights.collect::<Vec<_>>(), of_scales.collect()].map(|parts| B::float_cat(parts, 1));
        [Some(of_difference), Some(of_weights), Some(of_scales)]
    }
}

impl NegativeLogLikelihood {
    fn limited<B: Backend>(&self, log_scales: &FloatTensor<B>) -> [FloatTensor<B>; PARTS] {
        let [wide, narrow] = parts::<B>(log_scales);
        [
            B::float_clamp(wide, 0.0.into(), self.0.high.into()),
            B::float_clamp(narrow, self.0.low.into(), 0.0.into()),
        ]
    }

    /// Of each part, for both components.
    fn log_densities<B: Backend>(
        &self,
        difference: &FloatTensor<B>,
        log_weights: &[FloatTensor<B>; PARTS],
        log_scales: &[FloatTensor<B>; PARTS],
    ) -> [FloatTensor<B>; PARTS] {
        let distance = B::float_abs(difference.clone());
        std::array::from_fn(|k| {
            let log_peak = B::float_sub(log_weights[k].clone(), log_scales[k].clone());
            let log_peak = B::float_sub_scalar(log_peak, std::f32::consts::LN_2.into());
            let steepness = B::float_exp(B::float_neg(log_scales[k].clone()));
            B::float_sub(log_peak, B::float_mul(distance.clone(), steepness))
        })
    }
}

/// The channels, each `[batch, 1, height, width]`.
fn parts<B: Backend>(x: &FloatTensor<B>) -> [FloatTensor<B>; PARTS] {
    std::array::from_fn(|k| narrow::<B>(x.clone(), 1, k, 1))
}

/// `ln(e^a + e^b)` without overflow.
fn log_sum_exp<B: Backend>([a, b]: &[FloatTensor<B>; PARTS]) -> FloatTensor<B> {
    let apart = B::float_abs(B::float_sub(a.clone(), b.clone()));
    let twice_larger = B::float_add(B::float_add(a.clone(), b.clone()), apart.clone());
    let rest = B::float_log1p(B::float_exp(B::float_neg(apart)));
    B::float_add(B::float_mul_scalar(twice_larger, 0.5.into()), rest)
}

fn softmax<B: Backend>(x: &[FloatTensor<B>; PARTS]) -> [FloatTensor<B>; PARTS] {
    let sum = log_sum_exp::<B>(x);
    x.each_ref().map(|x| B::float_exp(B::float_sub(x.clone(), sum.clone())))
}
