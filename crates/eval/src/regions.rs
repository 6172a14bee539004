//! The pixels of a pair that scores of a region cover.

use srflow_core::{FlowField, Labels, Mask, Size};
use srflow_data::region_map::HeadPart;

use crate::results::Region;

/// The greatest distance of a pixel of the rim from the nearest pixel of the background, pixels.
const RIM: usize = 3;

/// The regions that a region map divides a frame into. Every pixel is in exactly one of them: a part does not contain its pixels
/// in the rim.
pub(crate) fn of_map(map: &Labels) -> Vec<(Region, Mask)> {
    let rim = rim(map);
    let at = |(&label, &in_rim): (&u8, &bool)| match HeadPart::of_label(label) {
        None => Region::Background,
        Some(_) if in_rim => Region::Rim,
        Some(HeadPart::Skin) => Region::Skin,
        Some(HeadPart::Eyes) => Region::Eyes,
        Some(HeadPart::Mouth) => Region::Mouth,
        Some(HeadPart::Hair) => Region::Hair,
        Some(HeadPart::Neck) => Region::Neck,
    };
    let regions: Vec<Region> = map.pixels().iter().zip(rim.pixels()).map(at).collect();
    let mask = |region| {
        let inside = |x: usize, y: usize| regions[y * map.width() + x] == region;
        (region, Mask::from_fn(map.width(), map.height(), inside))
    };
    Region::OF_MAPS.map(mask).into()
}

/// The pixels of the head at most [`RIM`] pixels away from the background in the frame, from centre to centre.
fn rim(map: &Labels) -> Mask {
    let Size { width, height } = map.size();
    let is_head = |x: usize, y: usize| map.get(x, y) > 0;
    let mut rim = Mask::new(width, height);
    let near = |at: usize, size: usize| at.saturating_sub(RIM)..(at + RIM + 1).min(size);
    for y in 0..height {
        for x in 0..width {
            // Of all pixels of the background, those beside the head are the nearest to it.
            let beside_head = (x > 0 && is_head(x - 1, y))
                || (x + 1 < width && is_head(x + 1, y))
                || (y > 0 && is_head(x, y - 1))
                || (y + 1 < height && is_head(x, y + 1));
            if is_head(x, y) || !beside_head {
                continue;
            }
            for row in near(y, height) {
                for column in near(x, width) {
                    let (dx, dy) = (column.abs_diff(x), row.abs_diff(y));
                    if dx * dx + dy * dy <= RIM * RIM && is_head(column, row) {
                        rim.set(column, row, true);
                    }
                }
            }
        }
    }
    rim
}

/// The pixels whose true flow is shorter than `limit` pixels; of the head, if there is a mask of it. `truth` and `head` have one size.
pub(crate) fn small_motion(truth: &FlowField, head: Option<&Mask>, limit: f32) -> Mask {
    Mask::from_fn(truth.width(), truth.height(), |x, y| {
        let [u, v] = truth.get(x, y);
        u.hypot(v) < limit && head.is_none_or(|head| head.get(x, y))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two discs with all parts in stripes, one of them cut off by the frame, and a single pixel.
    fn map() -> Labels {
        Labels::from_fn(60, 44, |x, y| {
            let in_disc = |cx: usize, cy: usize| x.abs_diff(cx).pow(2) + y.abs_diff(cy).pow(2) <= 15 * 15;
            let inside = in_disc(20, 18) || in_disc(50, 38) || (x, y) == (55, 3);
            if inside { 1 + (x / 3 % 5) as u8 } else { 0 }
        })
    }

    #[test]
    fn every_pixel_is_in_one_region() {
        let map = map();
        let regions = of_map(&map);
        let mask = |wanted| &regions.iter().find(|(region, _)| *region == wanted).unwrap().1;
        for y in 0..map.height() {
            for x in 0..map.width() {
                let holding: Vec<Region> =
                    regions.iter().filter(|(_, mask)| mask.get(x, y)).map(|(region, _)| *region).collect();
                assert_eq!(holding.len(), 1, "({x}, {y}) is in {holding:?}");
                let part = HeadPart::of_label(map.get(x, y)).map(HeadPart::name);
                assert_eq!(part.is_none(), mask(Region::Background).get(x, y));
                assert!(mask(Region::Rim).get(x, y) || part.unwrap_or("background") == holding[0].name());
            }
        }
        assert!(regions.iter().all(|(_, mask)| mask.pixels().contains(&true)));
    }

    /// Against the distances to all pixels of the background.
    #[test]
    fn the_rim_is_what_is_near_the_background() {
        let map = map();
        let rim = rim(&map);
        let all = || (0..map.height()).flat_map(|y| (0..map.width()).map(move |x| (x, y)));
        let background: Vec<(usize, usize)> = all().filter(|&(x, y)| map.get(x, y) == 0).collect();
        for (x, y) in all() {
            let distance =
                |&(bx, by): &(usize, usize)| (bx.abs_diff(x).pow(2) + by.abs_diff(y).pow(2)) as f64;
            let nearest = background.iter().map(distance).fold(f64::INFINITY, f64::min).sqrt();
            let expected = map.get(x, y) > 0 && nearest <= 3.0;
            assert_eq!(rim.get(x, y), expected, "({x}, {y}), {nearest} px from the background");
        }
        assert_eq!(
            super::rim(&Labels::filled(9, 9, 1)),
            Mask::new(9, 9),
            "the edge of the frame is no border"
        );
    }

    #[test]
    fn small_motion_is_on_the_head_and_known() {
        let truth =
            FlowField::from_fn(5, 1, |x, _| [[0.3, 0.3], [0.3, 0.5], [f32::NAN; 2], [0.0; 2], [0.0; 2]][x]);
        let head = Mask::from_fn(5, 1, |x, _| x < 4);
        let found = |head| small_motion(&truth, head, 0.5).into_pixels();
        assert_eq!(found(Some(&head)), [true, false, false, true, false]);
        assert_eq!(found(None), [true, false, false, true, true]);
    }
}
