/// The convex hull of points in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvexHull(Vec<[f64; 2]>);

impl ConvexHull {
    /// By Andrew's monotone chains.
    pub fn of(mut points: Vec<[f64; 2]>) -> Self {
        points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
            let mut chain: Vec<[f64; 2]> = Vec::new();
            for point in points {
                while let [.., a, b] = chain[..]
                    && turn(a, b, point) <= 0.0
                {
                    chain.pop();
                }
                chain.push(point);
            }
            chain.pop();
            chain
        };
        let mut corners = chain(&mut points.iter().copied());
        corners.extend(chain(&mut points.iter().rev().copied()));
        Self(corners)
    }

    /// Whether a point is inside, or on a side.
    pub fn contains(&self, point: [f64; 2]) -> bool {
        let sides = self.0.iter().zip(self.0.iter().cycle().skip(1));
        self.0.len() > 2 && sides.into_iter().all(|(&a, &b)| turn(a, b, point) >= 0.0)
    }
}

/// Twice the area of a triangle, above 0 if its corners turn from right to down.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_square_has_its_corners_and_contains_its_sides() {
        let square = [[0.0, 0.0], [4.0, 0.0], [2.0, 2.0], [4.0, 4.0], [0.0, 4.0], [1.0, 3.0], [2.0, 0.0]];
        let hull = ConvexHull::of(square.to_vec());
        assert_eq!(hull.0, [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        let inside = [[2.0, 2.0], [4.0, 1.0], [4.1, 1.0], [-0.1, 2.0]].map(|point| hull.contains(point));
        assert_eq!(inside, [true, true, false, false]);
        assert!(!ConvexHull::of(vec![[0.0, 0.0], [1.0, 0.0]]).contains([0.5, 0.0]));
    }
}
