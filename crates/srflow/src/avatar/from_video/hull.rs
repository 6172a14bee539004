//! The area of a face in a picture.

use srflow_avatar::capture::Face;
use srflow_core::Size;

/// The convex hull of points, such as a face's.
pub struct Hull(Vec<[f64; 2]>);

impl Hull {
    /// By Andrew's monotone chains.
    pub fn of(points: &[[f64; 2]]) -> Self {
        let mut sorted = points.to_vec();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let chain = |points: &mut dyn Iterator<Item = &[f64; 2]>| {
            let mut chain: Vec<[f64; 2]> = Vec::new();
            for point in points {
                while let [.., a, b] = chain[..]
                    && cross(a, b, *point) <= 0.0
                {
                    chain.pop();
                }
                chain.push(*point);
            }
            chain.pop();
            chain
        };
        Self([chain(&mut sorted.iter()), chain(&mut sorted.iter().rev())].concat())
    }

    /// How far a point is inside; negative outside.
    pub fn depth(&self, point: [f64; 2]) -> f64 {
        let edges = self.0.iter().zip(self.0.iter().cycle().skip(1));
        let distance =
            |(a, b): (&[f64; 2], &[f64; 2])| cross(*a, *b, point) / (b[0] - a[0]).hypot(b[1] - a[1]);
        edges.map(distance).fold(f64::INFINITY, f64::min)
    }
}

/// Places in a picture of this size, row by row, inside of the hull of a face's landmarks.
pub fn face_pixels(face: &Face, Size { width, height }: Size) -> Vec<usize> {
    let points: Vec<[f64; 2]> = face.iter().flatten().copied().collect();
    let hull = Hull::of(&points);
    let inside = |pixel: &usize| hull.depth([(pixel % width) as f64, (pixel / width) as f64]) > 0.0;
    (0..width * height).filter(inside).collect()
}

fn cross([ax, ay]: [f64; 2], [bx, by]: [f64; 2], [cx, cy]: [f64; 2]) -> f64 {
    (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_in_a_square_is_that_to_its_nearest_side() {
        let square = Hull::of(&[[0.0, 0.0], [4.0, 0.0], [2.0, 2.0], [4.0, 4.0], [0.0, 4.0], [1.0, 3.0]]);
        assert_eq!(square.0.len(), 4);
        assert_eq!([[2.0, 2.0], [1.0, 3.5], [5.0, 2.0]].map(|point| square.depth(point)), [2.0, 0.5, -1.0]);
    }
}
