//! AdamW, clipping and the schedule against PyTorch (golden values: `tools/parity/optimizer.py`).

use srflow_nn::{AdamW, AdamWState, Layout, Rounding, Segment, clip_norm};
use srflow_train::schedule::OneCycle;

const SIZES: [usize; 2] = [7, 40];

fn golden() -> serde_json::Value {
    serde_json::from_str(include_str!("../golden/optimizer.json")).expect("JSON")
}

fn tensor(size: usize, seed: usize) -> impl Iterator<Item = f32> {
    (0..size).map(move |i| ((i * 7919 + seed * 104_729) % 2048) as f32 / 1024.0 - 1.0)
}

#[test]
fn the_schedule_matches_pytorch() {
    for schedule in golden()["schedules"].as_array().expect("schedules") {
        let one_cycle = OneCycle {
            peak: schedule["peak"].as_f64().expect("peak"),
            total_steps: schedule["total"].as_u64().expect("total"),
            rising: schedule["pct_start"].as_f64().expect("share"),
        };
        for rate in schedule["rates"].as_array().expect("rates") {
            let (step, expected) = (rate[0].as_u64().expect("step"), rate[1].as_f64().expect("rate"));
            let found = one_cycle.learning_rate(step);
            assert!((found - expected).abs() < 1e-12 * one_cycle.peak, "step {step}: {found}, {expected}");
        }
    }
}

#[test]
fn schedules_of_any_length_have_a_valid_rate_at_every_step() {
    for total_steps in [0, 1, 2, 19, 20, 21] {
        let one_cycle = OneCycle { peak: 1.0, total_steps, rising: 0.05 };
        for step in 0..30 {
            let rate = one_cycle.learning_rate(step);
            assert!((0.0..=1.0).contains(&rate), "step {step} of {total_steps}: {rate}");
        }
    }
}

#[test]
fn steps_and_clipping_match_pytorch() {
    let sizes = [SIZES[0], SIZES[1], 3];
    let mut end = 0;
    let layout = Layout::from_segments(
        sizes
            .iter()
            .map(|&size| {
                end += size;
                Segment { name: end.to_string(), shape: vec![size], range: end - size..end, trained: true }
            })
            .collect(),
    );
    let mut values: Vec<f32> = sizes.iter().zip([3, 4, 9]).flat_map(|(&s, seed)| tensor(s, seed)).collect();
    let adamw = AdamW { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 1e-2, rounding: Rounding::Pytorch };
    let schedule = OneCycle { peak: 1e-2, total_steps: 20, rising: 0.3 };
    let mut state = AdamWState::new(values.len());
    let golden = golden();
    let training = &golden["training"];
    let mut states = training["states"].as_array().expect("states").iter();
    for (step, expected) in training["norms"].as_array().expect("norms").iter().enumerate() {
        let mut gradients: Vec<f32> = (0..2)
            .flat_map(|i| tensor(SIZES[i], 100 + 10 * step + i))
            .map(|x| x * 0.5_f32.powi(step as i32 / 2))
            .chain([0.0; 3])
            .collect();
        let norm = clip_norm(&mut gradients, 1.0);
        let expected = expected.as_f64().expect("norm");
        assert!((norm - expected).abs() < 1e-6 * expected, "step {step}: norm {norm}, {expected}");
        let rate = schedule.learning_rate(step as u64);
        adamw.step(&layout, &mut values, &gradients, &[true, true, false], rate, &mut state);
        if step == 0 || step == 11 {
            let tensors = states.next().expect("a state").as_array().expect("tensors");
            let expected = tensors.iter().flat_map(|tensor| tensor.as_array().expect("numbers"));
            for (i, (value, expected)) in values.iter().zip(expected).enumerate() {
                let expected = expected.as_f64().expect("a number");
                assert!((f64::from(*value) - expected).abs() < 2e-7, "step {step}, {i}: {value}, {expected}");
            }
        }
    }
    assert!(states.next().is_none());
}
