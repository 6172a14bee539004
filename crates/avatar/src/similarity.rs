//! Alignment of points with corresponding ones.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

/// `scale * (rotation * point) + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    pub scale: f64,
    pub rotation: DQuat,
    pub translation: DVec3,
}

impl Similarity {
    /// That of the first points onto the second ones, with these weights, of least squares (Horn 1987); `None` if they do not determine
    /// one.
    pub fn between(pairs: &[(DVec3, DVec3, f64)]) -> Option<Self> {
        Self::of(pairs, |turned, spread| turned / spread)
    }

    /// As [`between`](Self::between), with a scale of one.
    pub fn rigid(pairs: &[(DVec3, DVec3, f64)]) -> Option<Self> {
        Self::of(pairs, |_, _| 1.0)
    }

    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point * self.scale + self.translation
    }

    fn of(pairs: &[(DVec3, DVec3, f64)], scale: fn(f64, f64) -> f64) -> Option<Self> {
        let total: f64 = pairs.iter().map(|(.., weight)| weight).sum();
        let mean_from = pairs.iter().map(|(from, _, weight)| *from * *weight).sum::<DVec3>() / total;
        let mean_to = pairs.iter().map(|(_, to, weight)| *to * *weight).sum::<DVec3>() / total;
        let (mut s, mut spread) = (DMat3::ZERO, 0.0);
        for (from, to, weight) in pairs {
            let (from, to) = (*from - mean_from, (*to - mean_to) * *weight);
            s += DMat3::from_cols(to * from.x, to * from.y, to * from.z);
            spread += weight * from.length_squared();
        }
        // Entry (a, b) of Horn's S: the sum of from_a times to_b.
        let [x, y, z] = [s.x_axis, s.y_axis, s.z_axis];
        let matrix = DMat4::from_cols(
            DVec4::new(x.x + y.y + z.z, y.z - z.y, z.x - x.z, x.y - y.x),
            DVec4::new(y.z - z.y, x.x - y.y - z.z, x.y + y.x, z.x + x.z),
            DVec4::new(z.x - x.z, x.y + y.x, y.y - x.x - z.z, y.z + z.y),
            DVec4::new(x.y - y.x, z.x + x.z, y.z + z.y, z.z - x.x - y.y),
        );
        let q = largest_eigenvector(matrix);
        let rotation = DQuat::from_xyzw(q.y, q.z, q.w, q.x).normalize();
        // The trace of R S^T.
        let turned = DMat3::from_quat(rotation).transpose() * s;
        let scale = scale(turned.x_axis.x + turned.y_axis.y + turned.z_axis.z, spread);
        let translation = mean_to - rotation * mean_from * scale;
        let found = Self { scale, rotation, translation };
        (scale.is_finite() && rotation.is_finite() && translation.is_finite()).then_some(found)
    }
}

/// The eigenvector of a symmetric matrix for its largest eigenvalue, by Jacobi's rotations.
fn largest_eigenvector(matrix: DMat4) -> DVec4 {
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
    fn a_similarity_is_found_again() {
        let mut stream = Key::new(8).stream("similarity");
        let mut vector = || DVec3::from_array([0; 3].map(|_| f64::from(stream.normal())));
        let truth =
            Similarity { scale: 1.3, rotation: DQuat::from_scaled_axis(vector()), translation: vector() };
        let pairs: Vec<_> = (0..9)
            .map(|i| {
                let from = vector();
                (from, truth.apply(from), 1.0 + f64::from(i))
            })
            .collect();
        let found = Similarity::between(&pairs).unwrap();
        assert!(
            (found.scale - 1.3).abs() < 1e-12 && (found.translation - truth.translation).length() < 1e-12
        );
        assert!(found.rotation.angle_between(truth.rotation) < 1e-6);
        let rigid = Similarity::rigid(&pairs).unwrap();
        assert!(rigid.scale == 1.0 && rigid.rotation.angle_between(truth.rotation) < 1e-6);
        assert_eq!(Similarity::between(&[]), None);
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
