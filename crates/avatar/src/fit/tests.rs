use glam::{DMat3, DQuat, DVec3};
use srflow_core::Size;
use srflow_core::random::Key;
use srflow_head::HeadModel;
use srflow_splat::Camera;

use super::arrow::{Step, System};
use super::problem::{Problem, Window};
use super::{FitOptions, LandmarkView};

/// The derivatives of the cost, of data and of all priors, are its differences.
#[test]
fn the_gradient_is_that_of_the_cost() {
    let model = HeadModel::builtin_average();
    let camera = Camera::centred(Size::new(550, 802), [2050.0; 2])
        .placed(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)), DVec3::new(0.0, 0.0, 1.1));
    let mut stream = Key::new(3).stream("landmarks");
    let mut random = |scale: f64| f64::from(stream.normal()) * scale;
    let views: Vec<LandmarkView> = (0..3)
        .map(|timestep| LandmarkView {
            timestep,
            camera_index: 0,
            camera,
            landmarks: std::array::from_fn(|_| Some([275.0 + random(40.0), 400.0 + random(40.0)])),
        })
        .collect();
    let options = FitOptions { eye_distance: Some(0.06), ..FitOptions::default() };
    let problem = Problem::new(&model, &views, &options);
    let window = Window::all(3).with_identity();
    let mut heads = problem.heads();
    for offset in &mut heads.offsets {
        *offset = DVec3::new(random(0.05), random(0.05), random(0.05));
    }
    let identity: Vec<f64> = heads.states[0].identity.iter().map(|_| random(1.0)).collect();
    for state in &mut heads.states {
        state.identity.clone_from(&identity);
        state.expressions.iter_mut().for_each(|weight| *weight = random(0.7));
        state.translation = DVec3::new(random(0.01), random(0.01), random(0.01));
        *state.joint_mut(0) = DQuat::from_scaled_axis(DVec3::new(random(0.1), random(0.1), random(0.1)));
    }
    let cost = |heads: &_| problem.linearise(heads, &window, 2.0).1;
    let (System { shared_gradient, blocks, .. }, _) = problem.linearise(&heads, &window, 2.0);
    for _ in 0..20 {
        let mut direction =
            |gradient: &[f64]| -> Vec<f64> { gradient.iter().map(|_| random(1e-5)).collect() };
        let shared = direction(&shared_gradient);
        let own: Vec<Vec<f64>> = blocks.iter().map(|block| direction(&block.gradient)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let parts = blocks.iter().zip(&own).map(|(block, own)| dot(&block.gradient, own));
        let expected = 2.0 * (dot(&shared_gradient, &shared) + parts.sum::<f64>());
        let negative = |of: &[f64]| -> Vec<f64> { of.iter().map(|value| -value).collect() };
        let (back, back_own) = (negative(&shared), own.iter().map(|own| negative(own)).collect());
        let step = |shared, own| Step { shared, own, shared_covariance: Vec::new() };
        let after = cost(&problem.moved(&heads, &window, &step(shared, own)));
        let before = cost(&problem.moved(&heads, &window, &step(back, back_own)));
        let found = 0.5 * (after - before);
        assert!((found - expected).abs() < 1e-3 * expected.abs().max(0.1), "{found} {expected}");
    }
}
