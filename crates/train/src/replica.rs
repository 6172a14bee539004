//! Gradients of a batch, data-parallel over one or more devices.
//!
//! Every device has a copy of the network and computes the gradients of its share of the batch. They are summed in host
//! memory in the order of the devices, weighted by the number of samples in each share, which gives the gradients of the
//! whole batch. Live batch norm computes its statistics on each device separately, as in PyTorch's data-parallel training
//! without synchronization; the running statistics of the devices are averaged after each step.

use std::sync::{Mutex, PoisonError};

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nets::{Network, Request};
use srflow_nn::{HostGradients, Layout, filled, numbers, with_batch_statistics};
use srflow_ops::with_precision;

use crate::batch::Batch;
use crate::loss::{LossError, Prediction, losses};
use crate::pass::{BatchLosses, Pass, PassSettings};
use crate::recompute;

/// Held while parameters are drawn: all networks of a device share one random generator, so drawing two at once would make
/// either depend on the other.
static SEEDING: Mutex<()> = Mutex::new(());

/// Copies of a network, one per device.
pub struct Replicas {
    layout: Layout,
    copies: Vec<Replica>,
    settings: PassSettings,
}

struct Replica {
    device: Device,
    network: Network,
}

impl Replicas {
    /// Copies of the network of `init` on each of `devices`, all with the same random parameters from `seed`, and the values of
    /// those in the order of the [`layout`](Self::layout). With `live_batch_norm`, batch norm uses the statistics of the batch.
    ///
    /// # Panics
    /// When `devices` is empty.
    pub fn new(
        init: impl Fn(&Device) -> Network,
        devices: &[Device],
        seed: u64,
        live_batch_norm: bool,
        settings: PassSettings,
    ) -> (Self, Vec<f32>) {
        let copy = |device: &Device| {
            let device = device.clone().autodiff();
            let network = with_batch_statistics(init(&device), live_batch_norm);
            Replica { device, network }
        };
        let copies: Vec<Replica> = devices.iter().map(copy).collect();
        let (layout, values) = {
            let _alone = SEEDING.lock().unwrap_or_else(PoisonError::into_inner);
            copies[0].device.seed(seed);
            Layout::of(&copies[0].network) // parameters are drawn when they are first read
        };
        let mut replicas = Self { layout, copies, settings };
        replicas.fill(&values);
        (replicas, values)
    }

    /// The position of each tensor among the values.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Sets the parameters of all copies.
    pub fn fill(&mut self, values: &[f32]) {
        for copy in &mut self.copies {
            let network = copy.network.clone();
            copy.network = filled(network, &self.layout, values);
        }
    }

    /// The network of the first device in evaluation mode: without gradients, batch norm with its running statistics.
    pub fn for_estimation(&self) -> Network {
        self.copies[0].network.valid()
    }

    /// Losses and gradients of a batch of clips, means over their pairs. `pairs` holds the first pairs of all clips, then the second
    /// ones, and so on; a network that [remembers](srflow_nets::Facts::remembers) goes along the clips, and gradients through
    /// its memory. Live batch norm updates its running statistics on each device; see
    /// [`collect_statistics`](Self::collect_statistics).
    ///
    /// # Errors
    /// When the loss needs a prediction that the network does not make.
    pub fn pass(&self, pairs: &[Batch]) -> Result<Pass, LossError> {
        let shares = split(pairs, self.copies.len());
        let passes: Vec<Result<Pass, LossError>> = std::thread::scope(|scope| {
            let (first, others) = self.copies.split_first().expect("a device");
            let others: Vec<_> = others
                .iter()
                .zip(&shares[1..])
                .map(|(copy, share)| scope.spawn(|| copy.pass(share, &self.layout, &self.settings)))
                .collect();
            let first = first.pass(&shares[0], &self.layout, &self.settings);
            std::iter::once(first)
                .chain(others.into_iter().map(|other| other.join().expect("a pass that did not panic")))
                .collect()
        });
        let mut passes = passes.into_iter().zip(&shares);
        let mut sum = Pass { gradients: HostGradients::zero(&self.layout), losses: BatchLosses::default() };
        passes.try_for_each(|(pass, share)| {
            let pass = pass?;
            let weight = share[0].len() as f64 / pairs[0].len() as f64;
            sum.gradients.add_host(&pass.gradients, weight as f32);
            sum.losses.add(&pass.losses, weight);
            Ok(())
        })?;
        Ok(sum)
    }

    /// Writes the running statistics, averaged over the copies, into `values`.
    pub fn collect_statistics(&self, values: &mut [f32]) {
        let copies: Vec<Vec<f32>> = self.copies.iter().map(|copy| Layout::of(&copy.network).1).collect();
        for segment in self.layout.segments().iter().filter(|segment| !segment.trained) {
            for i in segment.range.clone() {
                values[i] = copies.iter().map(|copy| copy[i]).sum::<f32>() / copies.len() as f32;
            }
        }
    }
}

/// Parts of a batch of clips, each with its first pairs, its second ones, and so on; see [`Batch::split`].
fn split(pairs: &[Batch], parts: usize) -> Vec<Vec<Batch>> {
    let mut of_parts: Vec<Vec<Batch>> = Vec::new();
    for (part, batch) in pairs.iter().flat_map(|batch| batch.split(parts).into_iter().enumerate()) {
        match of_parts.get_mut(part) {
            Some(pairs) => pairs.push(batch),
            None => of_parts.push(vec![batch]),
        }
    }
    of_parts
}

impl Replica {
    fn pass(&self, share: &[Batch], layout: &Layout, settings: &PassSettings) -> Result<Pass, LossError> {
        with_precision(settings.precision, || {
            let mut pass = Pass { gradients: HostGradients::zero(layout), losses: BatchLosses::default() };
            for part in split(share, settings.accumulate) {
                let weight = part[0].len() as f64 / share[0].len() as f64;
                let losses =
                    self.add_gradients(&part, layout, settings, weight as f32, &mut pass.gradients)?;
                pass.losses.add(&losses, weight);
            }
            Ok(pass)
        })
    }

    /// Adds the gradients of the mean loss of `pairs`, times `weight`, to `sum`.
    fn add_gradients(
        &self,
        pairs: &[Batch],
        layout: &Layout,
        settings: &PassSettings,
        weight: f32,
        sum: &mut HostGradients,
    ) -> Result<BatchLosses, LossError> {
        if let ([pair], true) = (pairs, settings.recompute) {
            return recompute::add_gradients(&self.network, pair, layout, settings, weight, sum);
        }
        let share = 1.0 / pairs.len() as f64;
        let mut total = Tensor::zeros([1], &self.device);
        let mut mean = BatchLosses::default();
        let mut memory = None;
        for pair in pairs {
            let start = settings.starts.draw(&self.network, pair, &self.device);
            let request =
                Request { every_iteration: true, memory, start, ..Request::new(settings.iterations) };
            let mut estimate = self.network.forward(pair.frames(&self.device), &request);
            memory = estimate.memory.take();
            let last = numbers(estimate.last().clone().inner());
            let predictions = Prediction::of(estimate);
            let losses = losses(&settings.loss, &predictions, &pair.loss_inputs(&self.device))?;
            mean.add(&BatchLosses { epe: pair.end_point_error(&last), ..BatchLosses::of(&losses) }, share);
            total = total + losses.total * share;
        }
        sum.add(&self.network, layout, &total.backward(), weight);
        Ok(mean)
    }
}
