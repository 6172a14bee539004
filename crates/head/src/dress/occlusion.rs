//! Ray casting against the head: a bounding volume hierarchy over its triangles.

use glam::Vec3;
use srflow_simd::{Isa, Simd, dispatch};

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

    /// How many of the rays from `origin` in `directions` (unit length) hit anything nearer than `reach`.
    pub fn blocked(&self, origin: Vec3, directions: impl Iterator<Item = Vec3>, reach: f32) -> u32 {
        let isa = Isa::best();
        let mut directions = directions.peekable();
        let mut blocked = 0;
        while directions.peek().is_some() {
            let mut bundle = Bundle { origin, reach, count: 0, directions: [Vec3::Z; RAYS] };
            for (ray, direction) in bundle.directions.iter_mut().zip(&mut directions) {
                *ray = direction;
                bundle.count += 1;
            }
            blocked += hit_rays(isa, self, &bundle).count_ones();
        }
        blocked
    }
}

/// Number of rays that are cast together, in the lanes of vectors.
const RAYS: usize = 16;

/// Rays from one point.
struct Bundle {
    origin: Vec3,
    reach: f32,
    /// Rays that are cast: the first ones.
    count: usize,
    directions: [Vec3; RAYS],
}

/// Some of the rays of a bundle, one bit each.
type RaySet = u16;

dispatch! {
    /// The rays that hit something.
    fn hit_rays = traverse(occluder: &Occluder, bundle: &Bundle) -> RaySet
}

#[inline(always)]
fn traverse<S: Simd>(_: S, occluder: &Occluder, bundle: &Bundle) -> RaySet {
    let Bundle { origin, reach, count, directions } = bundle;
    // Coordinate by coordinate, so that loops over rays become vector instructions.
    let lanes = |coordinate: usize| std::array::from_fn::<f32, RAYS, _>(|ray| directions[ray][coordinate]);
    let [x, y, z] = [0, 1, 2].map(lanes);
    let direction = |ray: usize| Vec3::new(x[ray], y[ray], z[ray]);
    let inverses: [[f32; RAYS]; 3] = [x, y, z].map(|lanes| lanes.map(f32::recip));
    let inverse = |ray: usize| Vec3::new(inverses[0][ray], inverses[1][ray], inverses[2][ray]);
    let mut hit = 0;
    let mut stack = [(0_u32, 0); 64];
    let mut depth = usize::from(!occluder.nodes.is_empty());
    stack[0] = (0, RaySet::MAX >> (RAYS - count));
    while depth > 0 {
        depth -= 1;
        let (index, rays) = stack[depth];
        let node = &occluder.nodes[index as usize];
        let rays = rays & !hit & some_of(|ray| enters(node, *origin, inverse(ray), *reach));
        if rays == 0 {
            continue;
        }
        if node.count == 0 {
            stack[depth] = (node.start, rays);
            stack[depth + 1] = (index + 1, rays);
            depth += 2;
            continue;
        }
        for triangle in &occluder.triangles[node.start as usize..(node.start + node.count) as usize] {
            hit |= rays & some_of(|ray| hits(triangle, *origin, direction(ray), *reach));
        }
    }
    hit
}

#[inline(always)]
fn some_of(holds: impl Fn(usize) -> bool) -> RaySet {
    let mut set = [0; RAYS];
    for (ray, bit) in set.iter_mut().enumerate() {
        *bit = RaySet::from(holds(ray)) << ray;
    }
    set.iter().fold(0, |all, bit| all | bit)
}

/// Whether a ray passes through the box of a node before `reach`; `inverse` is that of its direction, by coordinate.
#[inline(always)]
fn enters(node: &Node, origin: Vec3, inverse: Vec3, reach: f32) -> bool {
    let (near, far) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
    let enter = near.min(far).max_element();
    let leave = near.max(far).min_element();
    !((enter > leave) | (leave < 0.0) | (enter > reach))
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
#[inline(always)]
fn hits(&[corner, edge1, edge2]: &[Vec3; 3], origin: Vec3, direction: Vec3, reach: f32) -> bool {
    let p = direction.cross(edge2);
    let determinant = edge1.dot(p);
    let inverse = determinant.recip();
    let to_origin = origin - corner;
    let u = to_origin.dot(p) * inverse;
    let q = to_origin.cross(edge1);
    let v = direction.dot(q) * inverse;
    let t = edge2.dot(q) * inverse;
    // Without branches: NaN is no hit.
    (determinant.abs() >= 1e-14) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < reach)
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
        for _ in 0..50 {
            let origin = point(1.5);
            let directions: Vec<Vec3> = (0..20).map(|_| point(1.0).normalize()).collect();
            let one_by_one = directions.iter().filter(|&&direction| {
                soup.iter().any(|t| hits(&[t[0], t[1] - t[0], t[2] - t[0]], origin, direction, 1.0))
            });
            let expected = one_by_one.count() as u32;
            assert_eq!(occluder.blocked(origin, directions.into_iter(), 1.0), expected);
            blocked += expected;
        }
        assert!((100..900).contains(&blocked), "{blocked} of 1000 rays blocked: the scene tests too little");
    }

    #[test]
    fn an_empty_scene_blocks_no_ray() {
        assert_eq!(Occluder::new(std::iter::empty()).blocked(Vec3::ZERO, [Vec3::Z].into_iter(), 1.0), 0);
    }
}
