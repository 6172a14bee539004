//! A flow field as two planes, the layout that the kernels work on.

use srflow_core::{FlowField, Plane};

/// Flow in pixels: `u` to the right, `v` down; both planes of one size.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarFlow {
    pub u: Plane,
    pub v: Plane,
}

impl PlanarFlow {
    pub fn zero(width: usize, height: usize) -> Self {
        Self { u: Plane::new(width, height), v: Plane::new(width, height) }
    }

    /// Applies the same function to both components.
    pub fn map(&self, change: impl Fn(&Plane) -> Plane) -> Self {
        Self { u: change(&self.u), v: change(&self.v) }
    }
}

/// Replaces unknown flow by zero.
impl From<&FlowField> for PlanarFlow {
    fn from(field: &FlowField) -> Self {
        let mut flow = Self::zero(field.width(), field.height());
        for (([u, v], out_u), out_v) in
            field.pixels().iter().zip(flow.u.pixels_mut()).zip(flow.v.pixels_mut())
        {
            if u.is_finite() && v.is_finite() {
                (*out_u, *out_v) = (*u, *v);
            }
        }
        flow
    }
}

impl From<PlanarFlow> for FlowField {
    fn from(flow: PlanarFlow) -> Self {
        let mut field = Self::new(flow.u.width(), flow.u.height());
        for ((pixel, u), v) in field.pixels_mut().iter_mut().zip(flow.u.pixels()).zip(flow.v.pixels()) {
            *pixel = [*u, *v];
        }
        field
    }
}
