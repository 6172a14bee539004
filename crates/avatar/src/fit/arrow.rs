//! Normal equations of parameters that all timesteps share, parameters of each timestep, and smoothness between neighbours.

use srflow_core::dense::{inverse, product, subtract_transposed_product};

/// What one timestep adds to the normal equations.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Of its own parameters, d x d.
    pub hessian: Vec<f64>,
    /// Of its own and the shared parameters, d x s.
    pub cross: Vec<f64>,
    /// With respect to its own parameters, d.
    pub gradient: Vec<f64>,
}

/// The normal equations `H x = -g`. In H, timesteps next to each other are coupled by `-coupling` on the diagonal of their
/// common block; the diagonal of `hessian` already includes it.
#[derive(Debug, Clone)]
pub(super) struct System {
    /// Of the shared parameters, s x s.
    pub shared: Vec<f64>,
    /// With respect to the shared parameters, s.
    pub shared_gradient: Vec<f64>,
    pub blocks: Vec<Block>,
    /// One per parameter of a timestep.
    pub coupling: Vec<f64>,
}

/// The step that solves the normal equations.
#[derive(Debug, Clone)]
pub(super) struct Step {
    pub shared: Vec<f64>,
    /// One for each timestep.
    pub own: Vec<Vec<f64>>,
    /// Inverse of the Schur complement of the shared parameters, s x s: their covariance.
    pub shared_covariance: Vec<f64>,
}

impl Step {
    /// So many times as far.
    pub fn times(mut self, factor: f64) -> Self {
        self.shared.iter_mut().chain(self.own.iter_mut().flatten()).for_each(|value| *value *= factor);
        self
    }
}

impl System {
    /// Solves the equations with `damping` times the diagonal added to the diagonal (Levenberg-Marquardt), by eliminating one
    /// timestep after the other and then the Schur complement of the shared parameters: time and memory are linear in the
    /// number of timesteps. `None` when the matrix is not positive definite.
    pub fn solve(&self, damping: f64) -> Option<Step> {
        let (s, d) = (self.shared_gradient.len(), self.coupling.len());
        let damped = |matrix: &[f64], n: usize| {
            let mut matrix = matrix.to_vec();
            for i in 0..n {
                matrix[i * n + i] *= 1.0 + damping;
            }
            matrix
        };
        // Columns: gradient, then the shared parameters.
        let width = 1 + s;
        let mut shared = vec![0.0; s * width];
        let of_shared = damped(&self.shared, s);
        for (i, row) in shared.chunks_exact_mut(width).enumerate() {
            row[0] = self.shared_gradient[i];
            row[1..].copy_from_slice(&of_shared[i * s..][..s]);
        }
        let mut eliminated: Vec<(Vec<f64>, Vec<f64>)> = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let mut hessian = damped(&block.hessian, d);
            let mut right = vec![0.0; d * width];
            for (i, row) in right.chunks_exact_mut(width).enumerate() {
                row[0] = block.gradient[i];
                row[1..].copy_from_slice(&block.cross[i * s..][..s]);
            }
            if let Some((before, solved)) = eliminated.last() {
                for (i, of_row) in self.coupling.iter().enumerate() {
                    for (j, of_column) in self.coupling.iter().enumerate() {
                        hessian[i * d + j] -= of_row * of_column * before[i * d + j];
                    }
                    for (sum, solved) in right[i * width..][..width].iter_mut().zip(&solved[i * width..]) {
                        *sum += of_row * solved;
                    }
                }
            }
            let inverse = inverse(hessian, d)?;
            let solved = product(&inverse, &right, d, width);
            let cross: Vec<f64> =
                right.chunks_exact(width).flat_map(|row| row[1..].iter().copied()).collect();
            subtract_transposed_product(&mut shared, &cross, &solved, s, width);
            eliminated.push((inverse, solved));
        }
        let schur: Vec<f64> = if s == 0 {
            Vec::new()
        } else {
            shared.chunks_exact(width).flat_map(|row| row[1..].iter().copied()).collect()
        };
        let shared_covariance = inverse(schur, s)?;
        let of_gradient: Vec<f64> = shared.chunks_exact(width).map(|row| -row[0]).collect();
        let shared = if s == 0 { Vec::new() } else { product(&shared_covariance, &of_gradient, s, 1) };

        let mut own: Vec<Vec<f64>> = Vec::with_capacity(eliminated.len());
        for (inverse, solved) in eliminated.iter().rev() {
            let mut step: Vec<f64> = solved
                .chunks_exact(width)
                .map(|row| -row[0] - row[1..].iter().zip(&shared).map(|(a, b)| a * b).sum::<f64>())
                .collect();
            if let Some(after) = own.last() {
                let pulled: Vec<f64> = self.coupling.iter().zip(after).map(|(c, after)| c * after).collect();
                for (step, pull) in step.iter_mut().zip(product(inverse, &pulled, d, 1)) {
                    *step += pull;
                }
            }
            own.push(step);
        }
        own.reverse();
        Some(Step { shared, own, shared_covariance })
    }
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    #[test]
    fn steps_solve_the_whole_system() {
        for (seed, (s, d, timesteps)) in (0..).zip([(3, 4, 5), (0, 2, 3), (2, 3, 1), (5, 1, 8)]) {
            let mut stream = Key::new(seed).stream("arrow");
            let mut random =
                |count: usize| -> Vec<f64> { (0..count).map(|_| f64::from(stream.normal())).collect() };
            // Positive definite: the sum of outer products of random rows that involve one timestep each, plus the coupling.
            let coupling: Vec<f64> = random(d).iter().map(|c| c.abs() + 0.1).collect();
            let mut shared = vec![0.0; s * s];
            for i in 0..s {
                shared[i * s + i] = 1.0;
            }
            let mut blocks = Vec::new();
            for timestep in 0..timesteps {
                let mut block =
                    Block { hessian: vec![0.0; d * d], cross: vec![0.0; d * s], gradient: random(d) };
                for _ in 0..s + d {
                    let row = random(s + d);
                    for i in 0..s {
                        (0..s).for_each(|j| shared[i * s + j] += row[i] * row[j]);
                    }
                    for i in 0..d {
                        (0..d).for_each(|j| block.hessian[i * d + j] += row[s + i] * row[s + j]);
                        (0..s).for_each(|j| block.cross[i * s + j] += row[s + i] * row[j]);
                    }
                }
                let neighbours = usize::from(timestep > 0) + usize::from(timestep + 1 < timesteps);
                for (i, coupling) in coupling.iter().enumerate() {
                    block.hessian[i * d + i] += 1e-3 + coupling * neighbours as f64;
                }
                blocks.push(block);
            }
            let system = System { shared, shared_gradient: random(s), blocks, coupling };
            let damping = 0.1;
            let step = system.solve(damping).expect("positive definite");
            // Every row of H x + g, block by block.
            let scale = |i: usize, j: usize| if i == j { 1.0 + damping } else { 1.0 };
            for i in 0..s {
                let mut sum = system.shared_gradient[i];
                sum += (0..s).map(|j| system.shared[i * s + j] * scale(i, j) * step.shared[j]).sum::<f64>();
                for (block, own) in system.blocks.iter().zip(&step.own) {
                    sum += (0..d).map(|j| block.cross[j * s + i] * own[j]).sum::<f64>();
                }
                assert!(sum.abs() < 1e-9, "{sum}");
            }
            for (t, block) in system.blocks.iter().enumerate() {
                for i in 0..d {
                    let mut sum = block.gradient[i];
                    sum +=
                        (0..d).map(|j| block.hessian[i * d + j] * scale(i, j) * step.own[t][j]).sum::<f64>();
                    sum += (0..s).map(|j| block.cross[i * s + j] * step.shared[j]).sum::<f64>();
                    for other in [t.checked_sub(1), Some(t + 1)].into_iter().flatten() {
                        sum -= system.coupling[i] * step.own.get(other).map_or(0.0, |own| own[i]);
                    }
                    assert!(sum.abs() < 1e-9, "{sum}");
                }
            }
        }
    }

    #[test]
    fn an_indefinite_system_has_no_step() {
        let block = Block { hessian: vec![1.0, 2.0, 2.0, 1.0], cross: vec![], gradient: vec![1.0, 1.0] };
        let system =
            System { shared: vec![], shared_gradient: vec![], blocks: vec![block], coupling: vec![0.0; 2] };
        assert!(system.solve(0.0).is_none());
    }
}
