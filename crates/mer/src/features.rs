//! The input of classifiers: the flow from onset to apex and its optical strain.

use srflow_core::resize::LinearTap;
use srflow_core::{Plane, Size};

/// Width and height of the feature maps, in pixels.
pub const FEATURE_SIDE: usize = 112;

const AREA: usize = FEATURE_SIDE * FEATURE_SIDE;

/// The feature maps, in the order of [`Features::values`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Flow to the right, in pixels of the feature map.
    U = 0,
    /// Flow downwards, in pixels of the feature map.
    V = 1,
    Strain = 2,
}

/// `u`, `v` and optical strain of one clip, `[3, 112, 112]`, row-major; every value is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Features(Box<[f32]>);

/// Why values are not valid [`Features`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FeatureError {
    /// A plane has the wrong size.
    #[error("feature map {channel:?} is {size} (WIDTHxHEIGHT), expected {FEATURE_SIDE}x{FEATURE_SIDE}")]
    Size {
        channel: Channel,
        /// Its width and height.
        size: Size,
    },
    /// The number of values is wrong.
    #[error("{found} values, expected 3 x {FEATURE_SIDE} x {FEATURE_SIDE}")]
    Length { found: usize },
    #[error("feature map {channel:?} holds a value that is not finite at pixel ({x}, {y})")]
    NotFinite { channel: Channel, x: usize, y: usize },
}

impl Features {
    /// Length of [`values`](Self::values).
    pub const LEN: usize = 3 * AREA;

    /// Combines the three maps.
    ///
    /// # Errors
    /// When one of them is not 112x112 or has a value that is not finite.
    pub fn new(u: &Plane, v: &Plane, strain: &Plane) -> Result<Self, FeatureError> {
        let mut values = Vec::with_capacity(Self::LEN);
        for (channel, plane) in [(Channel::U, u), (Channel::V, v), (Channel::Strain, strain)] {
            if plane.size() != Size::new(FEATURE_SIDE, FEATURE_SIDE) {
                return Err(FeatureError::Size { channel, size: plane.size() });
            }
            values.extend_from_slice(plane.pixels());
        }
        Self::from_values(values)
    }

    /// Wraps `[3, 112, 112]` values, row-major.
    ///
    /// # Errors
    /// When their number is wrong, or one of them is not finite.
    pub fn from_values(values: Vec<f32>) -> Result<Self, FeatureError> {
        if values.len() != Self::LEN {
            return Err(FeatureError::Length { found: values.len() });
        }
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            let channel = [Channel::U, Channel::V, Channel::Strain][at / AREA];
            let (x, y) = (at % FEATURE_SIDE, at % AREA / FEATURE_SIDE);
            return Err(FeatureError::NotFinite { channel, x, y });
        }
        Ok(Self(values.into()))
    }

    /// All values, `[3, 112, 112]`, row-major.
    pub fn values(&self) -> &[f32] {
        &self.0
    }

    /// One map, `[112, 112]`, row-major.
    pub fn channel(&self, channel: Channel) -> &[f32] {
        &self.0[channel as usize * AREA..][..AREA]
    }

    /// One map as a plane of 112x112.
    pub fn plane(&self, channel: Channel) -> Plane {
        let values = self.channel(channel);
        Plane::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| values[y * FEATURE_SIDE + x])
    }

    /// Places in the maps, in pixels, of places that are given as shares of their sides.
    pub(crate) fn pixels_of_shares<const N: usize>(shares: &[[f64; 2]; N]) -> [[f64; 2]; N] {
        shares.map(|place| place.map(|share| share * FEATURE_SIDE as f64 - 0.5))
    }

    /// The features of the mirrored clip: columns are reversed, `u` changes its sign, and the strain stays what it is.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let mut values = self.0.clone();
        values.chunks_exact_mut(FEATURE_SIDE).for_each(<[f32]>::reverse);
        values[..AREA].iter_mut().for_each(|u| *u = -*u);
        Self(values)
    }

    /// The features of the clip rotated clockwise around the centre of the maps, interpolated linearly: vectors turn with their places,
    /// strain moves (no rotation changes the strain of `literature`). From outside the maps comes their nearest pixel.
    #[must_use]
    pub fn rotated(&self, degrees: f32) -> Self {
        let (sin, cos) = libm::sincosf(degrees.to_radians());
        let centre = (FEATURE_SIDE - 1) as f32 / 2.0;
        let mut values = vec![0.0; Self::LEN];
        for (y, x) in (0..FEATURE_SIDE).flat_map(|y| (0..FEATURE_SIDE).map(move |x| (y, x))) {
            let (right, down) = (x as f32 - centre, y as f32 - centre);
            let column = LinearTap::at(centre + cos * right + sin * down, FEATURE_SIDE);
            let row = LinearTap::at(centre - sin * right + cos * down, FEATURE_SIDE);
            let [u, v, strain] = [Channel::U, Channel::V, Channel::Strain].map(|channel| {
                let map = self.channel(channel);
                let across = |row: usize| {
                    let line = &map[row * FEATURE_SIDE..][..FEATURE_SIDE];
                    line[column.near] + column.weight * (line[column.far] - line[column.near])
                };
                let (near, far) = (across(row.near), across(row.far));
                near + row.weight * (far - near)
            });
            let at = y * FEATURE_SIDE + x;
            values[at] = cos * u - sin * v;
            values[AREA + at] = sin * u + cos * v;
            values[2 * AREA + at] = strain;
        }
        Self(values.into())
    }
}
