//! Made-up captures: landmarks of a head whose parameters are known.

use glam::{DMat3, DQuat, DVec3};
use srflow_avatar::fit::LandmarkView;
use srflow_core::Size;
use srflow_core::random::Key;
use srflow_head::{HeadModel, HeadPoints, HeadState, Look, Motion, Region};
use srflow_splat::Camera;

#[derive(Debug, Clone, Copy)]
pub struct Capture {
    pub seed: u64,
    pub cameras: usize,
    pub timesteps: usize,
    /// Standard deviation of each coordinate, pixels.
    pub noise: f64,
    /// Share of landmarks that are anywhere on the face.
    pub outliers: f64,
    /// Share of landmarks without a position.
    pub missing: f64,
    /// Standard deviation along each axis of where the detector puts landmarks on the head, from where the model has them; metres.
    pub offsets: f64,
}

/// Cameras in front of the head at the origin, as wide as NeRSemble's and 1.1 m away; one camera is in front.
pub fn cameras(count: usize) -> Vec<Camera> {
    let camera = |number: usize| {
        let share = if count == 1 { 0.5 } else { number as f64 / (count - 1) as f64 };
        let yaw = (share - 0.5) * 1.7;
        let pitch = if count == 1 { 0.0 } else { [-0.15, 0.25][number % 2] };
        let away = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch) * DVec3::Z;
        let forward = -away;
        let right = forward.cross(DVec3::Y).normalize();
        let axes = DMat3::from_cols(right, forward.cross(right), forward);
        let position = DVec3::new(0.0, 0.0, 0.05) + away * 1.1;
        Camera::centred(Size::new(550, 802), [2050.0, 2050.0]).placed(axes, position)
    };
    (0..count).map(camera).collect()
}

/// Landmarks, and what they are of.
pub fn capture(model: &HeadModel, made: Capture) -> (Vec<LandmarkView>, Vec<HeadState>) {
    let key = Key::new(made.seed);
    let mut stream = key.stream("synthetic capture");
    let identity: Vec<f64> =
        model.identities.iter().map(|_| f64::from(stream.normal().clamp(-1.8, 1.8))).collect();
    let points = HeadPoints::landmarks(model);
    // Long enough to reach a pose far from rest in the middle, from where the timesteps are taken.
    let motion = Motion::new(model, Look::First, key, made.timesteps + 30, 25.0);
    let state = |timestep: usize| {
        let pose = motion.at(model, timestep + 15).pose;
        let turn = timestep as f64 / 25.0;
        let mut state = HeadState {
            identity: identity.clone(),
            expressions: pose.expressions.iter().copied().map(f64::from).collect(),
            joints: pose.joints.iter().map(|rotation| DQuat::normalize(rotation.as_dquat())).collect(),
            translation: DVec3::new(0.02 * libm_sin(turn), 0.01, 0.02 * libm_sin(0.7 * turn)),
        };
        state.expressions.resize(model.expressions.len(), 0.0);
        *state.joint_mut(0) =
            DQuat::from_rotation_y(0.15 * libm_sin(1.3 * turn)) * DQuat::from_rotation_x(0.1);
        state
    };
    let states: Vec<HeadState> = (0..made.timesteps).map(state).collect();
    let mut offset = key.stream("offsets");
    let offsets: Vec<DVec3> = (0..68)
        .map(|_| DVec3::from_array([0; 3].map(|_| f64::from(offset.normal()))) * made.offsets)
        .collect();
    let mut views = Vec::new();
    for (timestep, state) in (0..).zip(&states) {
        let at = points.positions(state).into_iter().zip(&offsets);
        let positions: Vec<DVec3> = at.map(|(at, offset)| at + state.joint(0) * *offset).collect();
        for (camera_index, camera) in (0..).zip(cameras(made.cameras)) {
            let pixels: Vec<[f64; 2]> =
                positions.iter().map(|p| camera.project(*p).expect("in front").0.to_array()).collect();
            let landmarks = std::array::from_fn(|landmark| {
                let [x, y] = pixels[landmark];
                let (dx, dy) = (f64::from(stream.normal()), f64::from(stream.normal()));
                let missing = f64::from(stream.unit()) < made.missing;
                let outlier = f64::from(stream.unit()) < made.outliers;
                let anywhere = [stream.uniform(100.0, 450.0), stream.uniform(200.0, 600.0)].map(f64::from);
                let seen = if outlier { anywhere } else { [x + made.noise * dx, y + made.noise * dy] };
                (!missing).then_some(seen)
            });
            views.push(LandmarkView { timestep, camera_index, camera, landmarks });
        }
    }
    (views, states)
}

fn libm_sin(x: f64) -> f64 {
    (DQuat::from_rotation_x(x) * DVec3::Y).z
}

/// Errors of vertices of the face, millimetres: on average over all timesteps, in the world, and without the mean displacement
/// of each timestep.
pub fn errors(truth: (&HeadModel, &[HeadState]), fitted: (&HeadModel, &[HeadState])) -> [f64; 2] {
    let face = face(truth.0);
    let posed = |(model, states): (&HeadModel, &[HeadState]), timestep: usize| -> Vec<DVec3> {
        let state = &states[timestep];
        let identity: Vec<f32> = state.identity.iter().map(|weight| *weight as f32).collect();
        let mut vertices = Vec::new();
        model.vertices(&model.shaped(&identity), &state.pose(), &mut vertices);
        face.iter().map(|vertex| vertices[*vertex as usize].as_dvec3()).collect()
    };
    let mut sums = [0.0; 2];
    for timestep in 0..truth.1.len() {
        let (truth, fitted) = (posed(truth, timestep), posed(fitted, timestep));
        let differences: Vec<DVec3> = truth.iter().zip(&fitted).map(|(a, b)| *a - *b).collect();
        let mean = differences.iter().sum::<DVec3>() / face.len() as f64;
        for difference in &differences {
            sums[0] += difference.length();
            sums[1] += (*difference - mean).length();
        }
    }
    sums.map(|sum| 1000.0 * sum / (face.len() * truth.1.len()) as f64)
}

/// Vertices of the face in front of the ears: skin, brows, lips and the rims of the lids.
fn face(model: &HeadModel) -> Vec<u32> {
    let facial =
        |region: &Region| matches!(region, Region::Skin | Region::Brow | Region::Lips | Region::LidMargin);
    let corners = model.triangles.iter().zip(&model.regions).filter(|(_, region)| facial(region));
    let mut vertices: Vec<u32> = corners.flat_map(|(corners, _)| *corners).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let rest = |landmark: usize| model.landmarks_on(&model.template).nth(landmark).expect("68 landmarks");
    let behind = rest(0).z.min(rest(16).z);
    vertices.retain(|vertex| model.template[*vertex as usize].z >= behind);
    vertices
}
