use glam::{DMat4, DVec2, DVec3};

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
    /// Pixel and depth (camera z) of a world point; `None` at or behind the camera's plane.
    pub fn project(&self, world: DVec3) -> Option<(DVec2, f64)> {
        let point = self.camera_from_world.transform_point3(world);
        (point.z > 0.0).then(|| {
            (
                DVec2::new(self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy),
                point.z,
            )
        })
    }
}

/// How normalised device coordinates become the pixel coordinates whose difference is the flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelConvention {
    /// `((ndc + 1) * S - 1) / 2`, as the 3DGS rasterizer places colour: flow and colour agree.
    #[default]
    Splat,
    /// `(ndc + 1) * (S - 1) / 2`, as the SRFlow paper writes (its equations for u and v): displacements are smaller
    /// by the factor `(S - 1) / S`.
    Paper,
}
