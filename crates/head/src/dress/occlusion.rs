//! Ray casting against the head: a bounding volume hierarchy over its triangles.

use glam::Vec3;

/// Maximum number of triangles in a leaf.
const LEAF: usize = 4;

struct Node {
    low: Vec3,
    high: Vec3,
    /// First triangle of a leaf, or index of the right child; the left child follows its parent.
    start: u32,
    /// Number of triangles in a leaf; 0 for an inner node.
    count: u32,
}

/// A set of triangles to cast rays at.
pub(super) struct Occluder {
    nodes: Vec<Node>,
    /// A corner and two edges of each triangle, in leaf order.
    triangles: Vec<[Vec3; 3]>,
}

impl Occluder {
    pub fn new(corners: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let mut triangles: Vec<[Vec3; 3]> = corners.collect();
        let mut nodes = Vec::with_capacity(triangles.len());
        if !triangles.is_empty() {
            build(&mut nodes, &mut triangles, 0);
        }
        for t in &mut triangles {
            *t = [t[0], t[1] - t[0], t[2] - t[0]];
        }
        Self { nodes, triangles }
    }

    /// Whether the ray from `origin` in `direction` (unit length) hits anything nearer than `reach`.
    pub fn blocks(&self, origin: Vec3, direction: Vec3, reach: f32) -> bool {
        let inverse = direction.recip();
        let mut stack = [0_u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            let (near, far) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            let enter = near.min(far).max_element();
            let leave = near.max(far).min_element();
            if enter > leave || leave < 0.0 || enter > reach {
                continue;
            }
            if node.count == 0 {
                stack[depth] = node.start;
                stack[depth + 1] = index + 1;
                depth += 2;
                continue;
            }
            let leaf = &self.triangles[node.start as usize..(node.start + node.count) as usize];
            if leaf.iter().any(|triangle| hits(triangle, origin, direction, reach)) {
                return true;
            }
        }
        false
    }
}

fn build(nodes: &mut Vec<Node>, triangles: &mut [[Vec3; 3]], offset: usize) {
    let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
    for corner in triangles.iter().flatten() {
        (low, high) = (low.min(*corner), high.max(*corner));
    }
    let index = nodes.len();
    nodes.push(Node { low, high, start: offset as u32, count: triangles.len() as u32 });
    if triangles.len() <= LEAF {
        return;
    }
    let extent = high - low;
    let axis = if extent.x >= extent.y.max(extent.z) { 0 } else { 1 + usize::from(extent.z > extent.y) };
    let middle = triangles.len() / 2;
    let key = |t: &[Vec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
    triangles.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)));
    let (left, right) = triangles.split_at_mut(middle);
    build(nodes, left, offset);
    nodes[index].start = nodes.len() as u32;
    nodes[index].count = 0;
    build(nodes, right, offset + middle);
}

/// Möller and Trumbore, *Fast, Minimum Storage Ray/Triangle Intersection* (1997).
fn hits(&[corner, edge1, edge2]: &[Vec3; 3], origin: Vec3, direction: Vec3, reach: f32) -> bool {
    let p = direction.cross(edge2);
    let determinant = edge1.dot(p);
    if determinant.abs() < 1e-14 {
        return false;
    }
    let inverse = determinant.recip();
    let to_origin = origin - corner;
    let u = to_origin.dot(p) * inverse;
    let q = to_origin.cross(edge1);
    let v = direction.dot(q) * inverse;
    let t = edge2.dot(q) * inverse;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < reach
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn agrees_with_trying_every_triangle() {
        let mut stream = Key::new(1).stream("occlusion");
        let mut point = |size: f32| {
            Vec3::new(stream.uniform(-size, size), stream.uniform(-size, size), stream.uniform(-size, size))
        };
        let soup: Vec<[Vec3; 3]> = (0..300)
            .map(|_| {
                let center = point(1.0);
                std::array::from_fn(|_| center + point(0.4))
            })
            .collect();
        let occluder = Occluder::new(soup.iter().copied());
        let mut blocked = 0;
        for _ in 0..500 {
            let (origin, direction) = (point(1.5), point(1.0).normalize());
            let expected =
                soup.iter().any(|t| hits(&[t[0], t[1] - t[0], t[2] - t[0]], origin, direction, 1.0));
            assert_eq!(occluder.blocks(origin, direction, 1.0), expected);
            blocked += usize::from(expected);
        }
        assert!((50..450).contains(&blocked), "{blocked} of 500 rays blocked: the scene tests too little");
    }

    #[test]
    fn an_empty_scene_blocks_no_ray() {
        assert!(!Occluder::new(std::iter::empty()).blocks(Vec3::ZERO, Vec3::Z, 1.0));
    }
}
