//! Clips of motion over time.

use glam::DQuat;
use srflow_files::FileProblem;

use super::animation::{Animation, Channel};
use super::document::{Document, problem, unit};

/// A property of one node over time.
#[derive(Debug)]
pub struct Track {
    /// Number of the node.
    pub node: usize,
    /// `rotation`, or `weights` of morph targets.
    pub property: String,
    /// Ascending, seconds.
    times: Vec<f32>,
    /// As many numbers for each time; with cubic splines three times as many: tangent in, value, tangent out.
    values: Vec<f32>,
    interpolation: Interpolation,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Interpolation {
    Step,
    Linear,
    CubicSpline,
}

impl Document {
    /// The rotations and weights of a clip over time. Its translations and scales are left out.
    ///
    /// # Errors
    /// When a part of it is missing or malformed.
    pub fn tracks(&self, clip: &Animation) -> Result<Vec<Track>, FileProblem> {
        let mut tracks = Vec::new();
        for Channel { sampler, target } in &clip.channels {
            let (Some(node), "rotation" | "weights") = (target.node, target.path.as_str()) else { continue };
            let sampler = clip
                .samplers
                .get(*sampler)
                .ok_or_else(|| problem("sampler", "one of the clip's", sampler.to_string()))?;
            let interpolation = match sampler.interpolation.as_str() {
                "" | "LINEAR" => Interpolation::Linear,
                "STEP" => Interpolation::Step,
                "CUBICSPLINE" => Interpolation::CubicSpline,
                other => return Err(problem("interpolation", "LINEAR, STEP or CUBICSPLINE", other)),
            };
            let times = self.numbers(sampler.input, 1, None)?;
            if times.is_empty() || !times.is_sorted() {
                return Err(problem("times of a clip", "at least one, in ascending order", "others"));
            }
            let components = if target.path == "rotation" { 4 } else { 1 };
            let values = self.numbers(sampler.output, components, None)?;
            let parts = if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
            let per_time = values.len() / times.len();
            if per_time == 0
                || values.len() != per_time * times.len()
                || !per_time.is_multiple_of(parts)
                || (components == 4 && per_time != 4 * parts)
            {
                let expected = format!("a value for each of {} times", times.len());
                return Err(problem("values of a clip", &expected, format!("{} numbers", values.len())));
            }
            tracks.push(Track { node, property: target.path.clone(), times, values, interpolation });
        }
        Ok(tracks)
    }
}

impl Track {
    /// Length, seconds.
    pub fn end(&self) -> f32 {
        self.times.last().copied().unwrap_or_default()
    }

    /// The rotation at a time, seconds.
    pub fn rotation(&self, time: f32) -> DQuat {
        let (from, share) = self.place(time);
        let quaternion =
            |of: &[f32]| std::array::from_fn(|i| f64::from(of.get(i).copied().unwrap_or_default()));
        if self.interpolation == Interpolation::Linear {
            let [a, b] = [from, from + 1].map(|at| unit(quaternion(self.value(at))));
            return a.slerp(b, f64::from(share));
        }
        unit(quaternion(&self.at(from, share)))
    }

    /// The numbers at a time, seconds.
    pub fn weights(&self, time: f32) -> Vec<f32> {
        let (from, share) = self.place(time);
        self.at(from, share)
    }

    /// The last key at or before a time, or the first, and the share of the way to the next.
    fn place(&self, time: f32) -> (usize, f32) {
        let from = self.times.partition_point(|key| *key <= time).saturating_sub(1);
        let Some(next) = self.times.get(from + 1) else { return (from, 0.0) };
        let share = (time - self.times[from]) / (next - self.times[from]).max(f32::MIN_POSITIVE);
        (from, share.clamp(0.0, 1.0))
    }

    /// The numbers of a key, of the last for those after.
    fn value(&self, key: usize) -> &[f32] {
        let per_time = self.values.len() / self.times.len();
        let start = key.min(self.times.len() - 1) * per_time;
        let of_key = &self.values[start..start + per_time];
        if self.interpolation == Interpolation::CubicSpline {
            &of_key[per_time / 3..per_time / 3 * 2]
        } else {
            of_key
        }
    }

    fn at(&self, from: usize, share: f32) -> Vec<f32> {
        let (a, b) = (self.value(from), self.value(from + 1));
        let pairs = a.iter().zip(b);
        match self.interpolation {
            Interpolation::Step => a.to_vec(),
            Interpolation::Linear => pairs.map(|(a, b)| a + (b - a) * share).collect(),
            Interpolation::CubicSpline if from + 1 >= self.times.len() => a.to_vec(),
            Interpolation::CubicSpline => {
                let (t, count) = (share, a.len());
                let seconds = self.times[from + 1] - self.times[from];
                let leaving = &self.values[3 * count * from + 2 * count..][..count];
                let arriving = &self.values[3 * count * (from + 1)..][..count];
                let tangents = leaving.iter().zip(arriving);
                pairs
                    .zip(tangents)
                    .map(|((a, b), (leaving, arriving))| {
                        let (t2, t3) = (t * t, t * t * t);
                        (2.0 * t3 - 3.0 * t2 + 1.0) * a
                            + (t3 - 2.0 * t2 + t) * seconds * leaving
                            + (3.0 * t2 - 2.0 * t3) * b
                            + (t3 - t2) * seconds * arriving
                    })
                    .collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(interpolation: Interpolation, values: &[f32]) -> Track {
        let times = vec![1.0, 2.0, 4.0];
        Track { node: 0, property: "weights".into(), times, values: values.to_vec(), interpolation }
    }

    #[test]
    fn numbers_between_keys() {
        let steps = track(Interpolation::Step, &[1.0, 3.0, 5.0]);
        let lines = track(Interpolation::Linear, &[1.0, 3.0, 5.0]);
        let at = |track: &Track| [0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0].map(|time| track.weights(time)[0]);
        assert_eq!(at(&steps), [1.0, 1.0, 1.0, 3.0, 3.0, 5.0, 5.0]);
        assert_eq!(at(&lines), [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.0]);
        // The spline through x^2 with its tangents is x^2.
        let keys = [1.0_f32, 2.0, 4.0].map(|x| [2.0 * x, x * x, 2.0 * x]);
        let spline = track(Interpolation::CubicSpline, keys.as_flattened());
        for time in [1.0_f32, 1.3, 2.0, 2.5, 3.9, 4.0] {
            assert!((spline.weights(time)[0] - time * time).abs() < 1e-5, "{time}");
        }
    }

    #[test]
    fn rotations_take_the_short_way() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let mut track =
            track(Interpolation::Linear, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -half, -half, 0.0, 0.0, 0.0, 2.0]);
        track.property = "rotation".into();
        let turn = track.rotation(1.5);
        assert!(turn.angle_between(DQuat::from_rotation_z(std::f64::consts::FRAC_PI_4)) < 1e-6, "{turn}");
        assert!(track.rotation(9.0).angle_between(DQuat::IDENTITY) < 1e-9);
    }
}
