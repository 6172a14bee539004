use glam::DVec3;

use crate::RasterizeError;

/// Gradients of a loss with respect to the outputs of a rendering: lists as long as the frame has pixels, row-major. An empty
/// list stands for zeros.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameGradients {
    /// Of [`Frame::color`](crate::Frame::color), the colour before clamping.
    pub color: Vec<[f32; 3]>,
    /// Of [`Frame::alpha`](crate::Frame::alpha).
    pub alpha: Vec<f32>,
    /// Of [`Frame::depth`](crate::Frame::depth).
    pub depth: Vec<f32>,
    /// Of [`Frame::flow`](crate::Frame::flow).
    pub flow: Vec<[f32; 2]>,
    /// Of [`Frame::depth_next`](crate::Frame::depth_next).
    pub depth_next: Vec<f32>,
}

impl FrameGradients {
    /// Checks the length of each list, for an image of this size.
    pub(crate) fn validate(&self, (width, height): (usize, usize)) -> Result<(), RasterizeError> {
        let lists = [
            ("color", self.color.len()),
            ("alpha", self.alpha.len()),
            ("depth", self.depth.len()),
            ("flow", self.flow.len()),
            ("depth_next", self.depth_next.len()),
        ];
        for (list, found) in lists {
            if found != 0 && found != width * height {
                return Err(RasterizeError::GradientLength { list, found, width, height });
            }
        }
        Ok(())
    }
}

/// Gradient of a loss with respect to a camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraGradient {
    /// With respect to a translation after [`Camera::camera_from_world`](crate::Camera::camera_from_world), in camera axes and
    /// per world unit.
    pub translation: DVec3,
    /// With respect to a rotation after it: around the camera's axes and origin, per radian.
    pub rotation: DVec3,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
}
