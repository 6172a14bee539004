use super::*;
use crate::test_values::{assert_close, values};

const CHANNELS: usize = 9;
const VALUE_CHANNELS: usize = 5;

/// Queries, keys (of scores up to a few tens, so that some weights vanish) and values of `pixels`.
fn image(pixels: usize) -> [Vec<f32>; 3] {
    let scaled = |seed: u32| values(CHANNELS * pixels, seed).into_iter().map(|x| 4.0 * x).collect();
    [scaled(1), scaled(2), values(VALUE_CHANNELS * pixels, 3)]
}

#[test]
fn each_instruction_set_computes_the_definition_whatever_is_kept() {
    for pixels in [1, 30, 131, 450] {
        let [queries, keys, values] = image(pixels);
        let expected = reference::attention(&queries, &keys, &values, pixels);
        for isa in Isa::available() {
            for kept_bytes in [0, 4 * panel_columns(isa) * 4 * pixels, usize::MAX] {
                let weights = AttentionWeights::new(isa, &queries, &keys, pixels, kept_bytes);
                let what = format!("{pixels} pixels, {isa:?}, {} panels kept", weights.kept_panels);
                assert_close(&what, &weights.gather(&values), &expected, 5e-6);
            }
        }
    }
}

#[test]
fn kept_weights_stay_within_the_bytes_allowed() {
    let [queries, keys, _] = image(450);
    let isa = Isa::best();
    let panel = panel_columns(isa) * 450 * size_of::<f32>();
    for panels in [0, 3, 4, 7, 8] {
        let weights = AttentionWeights::new(isa, &queries, &keys, 450, panels * panel);
        assert!(weights.kept.len() * size_of::<f32>() <= panels * panel);
        assert!(weights.kept_panels + PANELS > panels);
    }
}

#[test]
fn scores_of_any_size_give_weights_that_sum_to_one() {
    let pixels = 200;
    for scale in [1e-20, 1.0, 1e4, 1e15] {
        let queries: Vec<f32> = values(CHANNELS * pixels, 4).into_iter().map(|x| scale * x).collect();
        let keys = values(CHANNELS * pixels, 5);
        let out = attention(&queries, &keys, &vec![1.0; 2 * pixels], [1, CHANNELS, pixels]);
        assert_close(&format!("scale {scale}"), &out, &vec![1.0; 2 * pixels], 1e-5);
    }
}

#[test]
fn images_do_not_see_each_other_and_results_do_not_depend_on_threads() {
    let pixels = 300;
    let [mut queries, mut keys, mut values] = image(pixels);
    let alone = attention(&queries, &keys, &values, [1, CHANNELS, pixels]);
    for x in [&mut queries, &mut keys, &mut values] {
        let other: Vec<f32> = x.iter().map(|x| 0.5 - x).collect();
        x.extend(other);
    }
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| attention(&queries, &keys, &values, [2, CHANNELS, pixels]))
    };
    let both = with(1);
    assert!(both == with(3));
    assert!(both[..alone.len()] == alone);
}
