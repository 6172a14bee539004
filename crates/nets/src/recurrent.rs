//! The loop of RAFT (Teed and Deng 2020) and its kin: look up correlations where the flow points, update a hidden state,
//! add the change of the flow it gives.

use burn::tensor::{Device, Int, Tensor};
use srflow_ops::correlation::tensor::Correlation;

use crate::encoded::Encoded;
use crate::features::Features;
use crate::frames::Border;

/// Pixels of a frame along the side of a pixel of the flow that is refined.
pub(crate) const STRIDE: usize = 8;

/// How to estimate.
#[derive(Debug, Clone)]
pub struct Request {
    /// Refinements.
    pub iterations: usize,
    /// The coarse flow to start from ([`Estimate::coarse`] of the frames before, moved along itself); else zero.
    pub start: Option<Tensor<4>>,
    /// Give the flow after every iteration, as training needs it. Otherwise only the last is upsampled.
    pub every_iteration: bool,
    /// Features of the first and of the second frames, where they are known already; see [`Features`].
    pub features: Option<[Features; 2]>,
    /// Everything that is known of the frames before they are refined: of them only the size is taken then.
    pub encoded: Option<Encoded>,
}

impl Request {
    /// Only the last flow, from nothing.
    pub fn new(iterations: usize) -> Self {
        Self { iterations, start: None, every_iteration: false, features: None, encoded: None }
    }
}

/// What a network gives.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v), after each iteration; one alone unless all were asked for.
    pub flows: Vec<Tensor<4>>,
    /// The last flow at an eighth of the (padded) size, in its own pixels: a start for the next pair of frames.
    pub coarse: Tensor<4>,
    /// The hidden state behind it.
    pub hidden: Tensor<4>,
}

impl Estimate {
    /// The last flow.
    pub fn last(&self) -> &Tensor<4> {
        &self.flows[self.flows.len() - 1]
    }
}

/// What one pass of the loop needs.
pub(crate) struct Loop<'a, Step, Upsample> {
    pub(crate) correlation: &'a Correlation,
    pub(crate) radius: usize,
    pub(crate) border: Border,
    /// Hidden state, flow and correlation windows to the next hidden state and the change of the flow.
    pub(crate) step: Step,
    /// Hidden state and coarse flow to fine flow.
    pub(crate) upsample: Upsample,
}

impl<Step, Upsample> Loop<'_, Step, Upsample>
where
    Step: Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> (Tensor<4>, Tensor<4>),
    Upsample: Fn(&Tensor<4>, Tensor<4>) -> Tensor<4>,
{
    /// Refines from `hidden`, `[batch, channels, height, width]`. Panics when no iteration or a start of another size is
    /// asked for.
    pub(crate) fn run(&self, hidden: Tensor<4>, request: &Request) -> Estimate {
        assert!(request.iterations > 0, "at least one iteration");
        let [batch, _, height, width] = hidden.dims();
        let grid = pixel_grid([batch, height, width], &hidden.device());
        let mut flow = grid.zeros_like();
        if let Some(start) = &request.start {
            assert_eq!(start.dims(), flow.dims(), "the coarse flow to start from");
            flow = start.clone();
        }
        let mut hidden = hidden;
        let mut flows = Vec::new();
        for iteration in 1..=request.iterations {
            flow = flow.detach();
            let windows = self.correlation.windows(grid.clone() + flow.clone(), self.radius);
            let (next, change) = (self.step)(hidden, flow.clone(), windows);
            hidden = next;
            flow = flow + change;
            if request.every_iteration || iteration == request.iterations {
                flows.push(self.border.remove((self.upsample)(&hidden, flow.clone())));
            }
        }
        Estimate { flows, coarse: flow, hidden }
    }
}

/// Every pixel's x and y: `[batch, 2, height, width]`.
fn pixel_grid([batch, height, width]: [usize; 3], device: &Device) -> Tensor<4> {
    let axis = |len: usize| Tensor::<1, Int>::arange(0..len as i64, device).float();
    let x = axis(width).reshape([1, 1, 1, width]).expand([batch, 1, height, width]);
    let y = axis(height).reshape([1, 1, height, 1]).expand([batch, 1, height, width]);
    Tensor::cat(vec![x, y], 1)
}
