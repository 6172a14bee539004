//! Small dense linear algebra in f64, on row-major slices.

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
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
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
pub fn inverse(mut a: Vec<f64>, n: usize) -> Option<Vec<f64>> {
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
pub fn product(a: &[f64], b: &[f64], m: usize, k: usize) -> Vec<f64> {
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
pub fn subtract_transposed_product(out: &mut [f64], a: &[f64], b: &[f64], n: usize, k: usize) {
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

#[cfg(test)]
mod tests {
    use crate::random::Key;

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
}
