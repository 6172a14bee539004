use serde::Serialize;
use serde_json::json;
use srflow_core::Size;
use srflow_splat::{Gaussians, Surroundings, Up};

use crate::pack::Pack;

/// Something cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    #[error("no Gaussian: there is nothing to show")]
    NoGaussians,
    #[error("encoding a frame of {size} pixels: {reason}")]
    Frame { size: Size, reason: String },
}

/// Where the camera looks.
#[derive(Serialize)]
pub(crate) struct Seen {
    centre: [f64; 3],
    radius: f64,
}

impl Seen {
    pub(crate) fn of(gaussians: &Gaussians) -> Result<Self, ViewError> {
        let seen = Surroundings::of(gaussians).ok_or(ViewError::NoGaussians)?;
        Ok(Self { centre: seen.centre.to_array(), radius: seen.radius })
    }
}

/// A page of Gaussians that do not move, in a world with this direction up: colour, depth and alpha from all sides.
///
/// # Errors
/// When there are none.
pub fn splats(title: &str, gaussians: &Gaussians, up: Up) -> Result<Pack, ViewError> {
    let mut pack = Pack::new(json!({
        "page": "splats",
        "title": title,
        "surroundings": Seen::of(gaussians)?,
        "upside_down": up == Up::MinusY,
        "sh_degree": gaussians.sh_degree,
        "sh_range": largest_harmonic(gaussians),
        "antialiased": gaussians.antialiased,
    }));
    add_gaussians(&mut pack, gaussians, &vec![0; gaussians.len()]);
    Ok(pack)
}

/// The largest coefficient above degree 0, which [`add_gaussians`] stores as 127.
pub(crate) fn largest_harmonic(gaussians: &Gaussians) -> f32 {
    let above = gaussians.sh.chunks(gaussians.sh_len()).flat_map(|each| &each[1..]);
    above.flatten().filter(|value| value.is_finite()).fold(0.0, |largest, value| value.abs().max(largest))
}

/// Adds Gaussians in the local frames of `triangles`, one each.
pub(crate) fn add_gaussians(pack: &mut Pack, gaussians: &Gaussians, triangles: &[u32]) {
    let positions: Vec<[f32; 3]> = gaussians.positions.iter().map(|position| position.to_array()).collect();
    pack.add("positions", positions.as_flattened());
    pack.add_halves("scales", gaussians.scales.iter().flat_map(|scale| scale.to_array()));
    pack.add_halves(
        "rotations",
        gaussians.rotations.iter().flat_map(|rotation| rotation.normalize().to_array()),
    );
    pack.add_halves("opacities", gaussians.opacities.iter().copied());
    pack.add("triangle_of", triangles);
    let each = gaussians.sh_len();
    pack.add_halves("sh_constant", gaussians.sh.iter().step_by(each).flatten().copied());
    let unit = 127.0 / largest_harmonic(gaussians).max(f32::MIN_POSITIVE);
    let above = gaussians.sh.chunks(each).flat_map(|each| &each[1..]).flatten();
    let bytes: Vec<i8> = above.map(|value| (value * unit).round() as i8).collect();
    pack.add("sh_rest", &bytes);
}
