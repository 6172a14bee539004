//! A pinhole camera, the files it is read from, and orbits.

mod camera_path;
mod colmap;
mod file;
mod formats;
mod gaussian_splatting;
mod nersemble;
mod orbit;
mod own;
mod transforms;

#[cfg(test)]
mod tests;

use glam::{DMat3, DMat4, DVec2, DVec3};
use srflow_core::Size;

pub use file::NamedCamera;
pub use formats::read_cameras;
pub use orbit::Surroundings;

use crate::CameraError;
use crate::gradients::CameraGradient;

/// Maximum number of pixels of an image: 134 million (16384x8192), as for flow files.
pub const MAX_PIXELS: usize = 1 << 27;

/// Maximum side of an image, in pixels.
pub const MAX_SIDE: usize = 1 << 19;

/// Gaussians whose centre is at this depth or nearer are culled, in scene units (3DGS reference, `in_frustum`).
pub const NEAR: f64 = 0.2;

/// A pinhole camera in the OpenCV convention: x right, y down, z forward; an integer coordinate is the centre of a
/// pixel, so the principal point of a symmetric frustum is `((width - 1) / 2, (height - 1) / 2)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Horizontal focal length in pixels.
    pub fx: f64,
    /// Vertical focal length in pixels.
    pub fy: f64,
    /// Column of the principal point in pixels; need not be the centre.
    pub cx: f64,
    /// Row of the principal point in pixels; need not be the centre.
    pub cy: f64,
    /// Camera from world, `[R|t]` over `0 0 0 1`.
    pub camera_from_world: DMat4,
}

impl Camera {
    /// A camera at the origin, with these focal lengths and the principal point at the centre of a picture of this size.
    pub fn centred(Size { width, height }: Size, [fx, fy]: [f64; 2]) -> Self {
        let middle = |side: usize| (side as f64 - 1.0) / 2.0;
        let (cx, cy) = (middle(width), middle(height));
        Self { width, height, fx, fy, cx, cy, camera_from_world: DMat4::IDENTITY }
    }

    /// The same camera in another pose: the columns of `world_from_camera` are its axes (right, down, forward) in the world.
    #[must_use]
    pub fn placed(self, world_from_camera: DMat3, position: DVec3) -> Self {
        let rotation = world_from_camera.transpose();
        let camera_from_world = DMat4::from_cols(
            rotation.x_axis.extend(0.0),
            rotation.y_axis.extend(0.0),
            rotation.z_axis.extend(0.0),
            (-(rotation * position)).extend(1.0),
        );
        Self { camera_from_world, ..self }
    }

    /// Width and height of the image.
    pub fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// The same view at another resolution.
    #[must_use]
    pub fn resized(self, Size { width, height }: Size) -> Self {
        let (x, y) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        let scaled = |place: f64, factor: f64| (place + 0.5) * factor - 0.5; // the corner of the first pixel is fixed
        let (fx, fy) = (self.fx * x, self.fy * y);
        Self { width, height, fx, fy, cx: scaled(self.cx, x), cy: scaled(self.cy, y), ..self }
    }

    /// Pixel and depth (camera z) of a world point; `None` at or behind the camera's plane.
    pub fn project(&self, world: DVec3) -> Option<(DVec2, f64)> {
        let point = self.camera_from_world.transform_point3(world);
        (point.z > 0.0).then(|| (self.pixel(point), point.z))
    }

    /// Position of the camera, in world units. The pose must be rigid, see [`Camera::validate`].
    pub fn position(&self) -> DVec3 {
        let t = self.camera_from_world.w_axis.truncate();
        -DVec3::new(
            self.camera_from_world.x_axis.truncate().dot(t),
            self.camera_from_world.y_axis.truncate().dot(t),
            self.camera_from_world.z_axis.truncate().dot(t),
        )
    }

    /// Pixel of a point in camera coordinates, which must be in front of the camera.
    pub(crate) fn pixel(&self, point: DVec3) -> DVec2 {
        DVec2::new(self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy)
    }

    /// The backward of [`pixel`](Self::pixel), given the gradient of the pixel: the gradient of the point; those of the
    /// intrinsics are added to `out`.
    pub(crate) fn pixel_backward(&self, point: DVec3, gradient: DVec2, out: &mut CameraGradient) -> DVec3 {
        out.fx += gradient.x * point.x / point.z;
        out.fy += gradient.y * point.y / point.z;
        out.cx += gradient.x;
        out.cy += gradient.y;
        let (x, y) = (self.fx * gradient.x, self.fy * gradient.y);
        DVec3::new(x, y, -(x * point.x + y * point.y) / point.z) / point.z
    }

    /// Checks whether the camera can be rendered.
    ///
    /// # Errors
    /// When the image is empty or is larger than [`MAX_PIXELS`] or [`MAX_SIDE`], an intrinsic is not finite, a focal length not
    /// positive, or the pose is not a rotation (to 1e-4) and a finite translation over the row `0 0 0 1`.
    pub fn validate(&self) -> Result<(), CameraError> {
        let size @ Size { width, height } = self.size();
        if width == 0 || height == 0 {
            return Err(CameraError::Empty { size });
        }
        if width.max(height) > MAX_SIDE || size.pixels() > MAX_PIXELS {
            return Err(CameraError::TooLarge { size });
        }
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(CameraError::FocalLength { name, value });
            }
        }
        if !(self.cx.is_finite() && self.cy.is_finite()) {
            return Err(CameraError::PrincipalPoint { cx: self.cx, cy: self.cy });
        }
        self.validate_pose().map_err(CameraError::NotRigid)
    }

    fn validate_pose(&self) -> Result<(), String> {
        const TOLERANCE: f64 = 1e-4;
        let pose = self.camera_from_world;
        if !pose.is_finite() {
            return Err("it has a number that is not finite".into());
        }
        let last = pose.row(3);
        if last.to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(format!("its last row is {last}, expected [0, 0, 0, 1]"));
        }
        let axes = [pose.x_axis.truncate(), pose.y_axis.truncate(), pose.z_axis.truncate()];
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate().take(i + 1) {
                let expected = if i == j { 1.0 } else { 0.0 };
                let dot = a.dot(*b);
                if (dot - expected).abs() > TOLERANCE {
                    return Err(format!(
                        "columns {j} and {i} have the inner product {dot}, expected {expected}"
                    ));
                }
            }
        }
        if axes[0].cross(axes[1]).dot(axes[2]) < 0.0 {
            return Err("it mirrors the world (its determinant is -1, expected 1)".into());
        }
        Ok(())
    }
}

/// The conversion from normalised device coordinates to the pixel coordinates whose difference is the flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelConvention {
    /// `((ndc + 1) * S - 1) / 2`, as the 3DGS rasterizer places colour: flow and colour agree.
    #[default]
    Splat,
    /// `(ndc + 1) * (S - 1) / 2`, as in the SRFlow paper (its equations for u and v): displacements are smaller by the factor
    /// `(S - 1) / S`.
    Paper,
}

impl PixelConvention {
    /// Pixels of this convention per image pixel, for an image side of `size` pixels.
    pub fn scale(self, size: usize) -> f64 {
        match self {
            Self::Splat => 1.0,
            Self::Paper => (size as f64 - 1.0) / size as f64,
        }
    }
}
