//! Small dense linear algebra in f64, on row-major slices.

use glam::{DMat4, DVec4};

/// Replaces the lower triangle of the symmetric `a` (n x n; the upper triangle is not read) by its Cholesky factor L in
/// `a = L L^T`. False if `a` is not positive definite.
fn cholesky(a: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (above, row) = a.split_at_mut(i * n);
        for j in 0..=i {
            let other = if j < i { &above[j * n..j * n + j] } else { &[] };
            if j < i {
                let sum = row[j] - dot(&row[..j], other);
                row[j] = sum / above[j * n + j];
            } else {
                let sum = row[i] - dot(&row[..i], &row[..i]);
                // NaN is not positive either.
                if !(sum > 0.0 && sum.is_finite()) {
                    return false;
                }
                row[i] = sum.sqrt();
            }
        }
    }
    true
}

/// In eight sums, which the compiler can keep in one register.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

/// The inverse of a symmetric positive definite matrix (n x n), of which the lower triangle is read; `None` if it is not
/// positive definite.
pub(crate) fn inverse(mut a: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    if n == 0 {
        return Some(a);
    }
    if !cholesky(&mut a, n) {
        return None;
    }
    // The inverse of L, row by row, and then L^-T L^-1.
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        let (above, row) = factor.split_at_mut(i * n);
        for k in 0..i {
            let weight = a[i * n + k];
            for (value, other) in row[..=k].iter_mut().zip(&above[k * n..=k * n + k]) {
                *value -= weight * other;
            }
        }
        row[i] = 1.0;
        let scale = 1.0 / a[i * n + i];
        row[..=i].iter_mut().for_each(|value| *value *= scale);
    }
    let mut inverse = vec![0.0; n * n];
    for row in factor.chunks_exact(n) {
        for (i, &weight) in row.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            for (sum, value) in inverse[i * n..=i * n + i].iter_mut().zip(row) {
                *sum += weight * value;
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            inverse[j * n + i] = inverse[i * n + j];
        }
    }
    Some(inverse)
}

/// `a b` for a: n x m and b: m x k.
pub(super) fn product(a: &[f64], b: &[f64], m: usize, k: usize) -> Vec<f64> {
    let n = a.len().checked_div(m).unwrap_or(0);
    let mut out = vec![0.0; n * k];
    if n * k == 0 {
        return out;
    }
    for (row, out) in a.chunks_exact(m).zip(out.chunks_exact_mut(k)) {
        for (weight, b) in row.iter().zip(b.chunks_exact(k)) {
            for (sum, value) in out.iter_mut().zip(b) {
                *sum += weight * value;
            }
        }
    }
    out
}

/// Subtracts `a^T b` from `out`, for a: m x n, b: m x k, out: n x k.
pub(super) fn subtract_transposed_product(out: &mut [f64], a: &[f64], b: &[f64], n: usize, k: usize) {
    if n == 0 || k == 0 {
        return;
    }
    for (a, b) in a.chunks_exact(n).zip(b.chunks_exact(k)) {
        for (weight, out) in a.iter().zip(out.chunks_exact_mut(k)) {
            for (sum, value) in out.iter_mut().zip(b) {
                *sum -= weight * value;
            }
        }
    }
}

/// The eigenvector of a symmetric matrix for its largest eigenvalue, by Jacobi's rotations.
pub(super) fn largest_eigenvector(matrix: DMat4) -> DVec4 {
    let mut a = matrix.to_cols_array_2d();
    let mut vectors = DMat4::IDENTITY.to_cols_array_2d();
    for _ in 0..32 {
        for p in 0..4 {
            for q in p + 1..4 {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + libm::hypot(theta, 1.0));
                let c = 1.0 / libm::hypot(t, 1.0);
                let s = t * c;
                for column in &mut a {
                    (column[p], column[q]) = (c * column[p] - s * column[q], s * column[p] + c * column[q]);
                }
                let (row_p, row_q) = (a[p], a[q]);
                a[p] = std::array::from_fn(|k| c * row_p[k] - s * row_q[k]);
                a[q] = std::array::from_fn(|k| s * row_p[k] + c * row_q[k]);
                for row in &mut vectors {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    let largest = (0..4).fold(0, |best, i| if a[i][i] > a[best][best] { i } else { best });
    DVec4::from_array(vectors.map(|row| row[largest]))
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    #[test]
    fn inverses_and_products_make_the_identity() {
        let mut stream = Key::new(5).stream("dense");
        for n in [0, 1, 2, 7, 30] {
            let root: Vec<f64> = (0..n * n).map(|_| f64::from(stream.normal())).collect();
            let mut matrix = vec![0.0; n * n];
            subtract_transposed_product(&mut matrix, &root, &root, n, n);
            matrix.iter_mut().for_each(|value| *value = -*value);
            (0..n).for_each(|i| matrix[i * n + i] += 0.1);
            let inverse = inverse(matrix.clone(), n).expect("positive definite");
            for (i, value) in product(&matrix, &inverse, n, n).into_iter().enumerate() {
                let expected = if i % (n + 1) == 0 { 1.0 } else { 0.0 };
                assert!((value - expected).abs() < 1e-8, "{n} {i} {value}");
            }
        }
        assert_eq!(inverse(vec![f64::NAN], 1), None);
    }

    #[test]
    fn the_eigenvector_is_stretched_most() {
        let mut stream = Key::new(6).stream("dense");
        for _ in 0..50 {
            let root = DMat4::from_cols_array(&std::array::from_fn(|_| f64::from(stream.normal())));
            let matrix = root + root.transpose();
            let vector = largest_eigenvector(matrix);
            let value = vector.dot(matrix * vector);
            assert!((matrix * vector - vector * value).length() < 1e-9, "{vector}");
            for _ in 0..20 {
                let other =
                    DVec4::from_array(std::array::from_fn(|_| f64::from(stream.normal()))).normalize();
                assert!(other.dot(matrix * other) <= value + 1e-9);
            }
        }
    }
}
