//! The regions of MDMO by dlib's 68 points, as the field draws them (the paper has 66 other points): from the brows to the chin, from the left of the
//! picture to the right. What lies above the brows is given in pixels there; here it is a share of the distance of the eyes.

use super::Corner::{At, Between, Off};
use super::Region;

const ABOVE: [f64; 2] = [0.0, -0.15];
const TWICE_ABOVE: [f64; 2] = [0.0, -0.3];

#[rustfmt::skip]
pub(super) const REGIONS: [Region; 36] = [
    Region { name: "1", corners: &[Off(17, ABOVE), Off(19, ABOVE), At(19), At(17)] },
    Region { name: "2", corners: &[Off(19, ABOVE), Off(21, ABOVE), At(21), At(19)] },
    Region { name: "3", corners: &[Off(21, ABOVE), Off(27, TWICE_ABOVE), At(27), At(21)] },
    Region { name: "4", corners: &[Off(27, TWICE_ABOVE), Off(22, ABOVE), At(27), At(22)] },
    Region { name: "5", corners: &[Off(22, ABOVE), Off(24, ABOVE), At(24), At(22)] },
    Region { name: "6", corners: &[Off(24, ABOVE), Off(26, ABOVE), At(26), At(24)] },
    Region { name: "7", corners: &[At(1), At(17), At(36)] },
    Region { name: "8", corners: &[At(17), At(19), At(37), At(36)] },
    Region { name: "9", corners: &[At(19), At(38), At(39), At(21)] },
    Region { name: "10", corners: &[At(21), At(27), At(28), At(39)] },
    Region { name: "11", corners: &[At(22), At(27), At(28), At(42)] },
    Region { name: "12", corners: &[At(22), At(42), At(43), At(24)] },
    Region { name: "13", corners: &[At(24), At(44), At(45), At(26)] },
    Region { name: "14", corners: &[At(26), At(16), At(15), At(45)] },
    Region { name: "15", corners: &[At(2), Between(2, 41), Between(3, 29), At(3)] },
    Region { name: "16", corners: &[At(41), Between(2, 41), Between(3, 29), At(39)] },
    Region { name: "17", corners: &[At(39), Between(3, 29), At(29), At(28)] },
    Region { name: "18", corners: &[At(28), At(29), Between(13, 29), At(42)] },
    Region { name: "19", corners: &[At(42), At(46), Between(14, 46), Between(13, 29)] },
    Region { name: "20", corners: &[Between(14, 46), At(14), At(13), Between(13, 29)] },
    Region { name: "21", corners: &[At(3), Between(3, 29), Between(4, 33), At(4)] },
    Region { name: "22", corners: &[Between(4, 33), Between(3, 29), At(29), At(33)] },
    Region { name: "23", corners: &[At(33), At(29), Between(13, 29), Between(12, 33)] },
    Region { name: "24", corners: &[Between(13, 29), At(13), At(12), Between(12, 33)] },
    Region { name: "25", corners: &[At(4), Between(4, 33), Between(5, 59), At(5)] },
    Region { name: "26", corners: &[Between(5, 59), Between(4, 33), At(33), At(59)] },
    Region { name: "27", corners: &[At(33), At(55), Between(11, 55), Between(12, 33)] },
    Region { name: "28", corners: &[Between(11, 55), Between(12, 33), At(12), At(11)] },
    Region { name: "29", corners: &[At(59), At(58), Between(6, 58), Between(5, 59)] },
    Region { name: "30", corners: &[Between(6, 58), At(58), At(57), Between(8, 57)] },
    Region { name: "31", corners: &[At(57), Between(8, 57), Between(10, 56), At(56)] },
    Region { name: "32", corners: &[At(56), Between(10, 56), Between(11, 55), At(55)] },
    Region { name: "33", corners: &[At(5), Between(5, 59), Between(6, 58), At(6)] },
    Region { name: "34", corners: &[At(6), Between(6, 58), Between(8, 57), At(8)] },
    Region { name: "35", corners: &[Between(8, 57), Between(10, 56), At(10), At(8)] },
    Region { name: "36", corners: &[Between(10, 56), At(10), At(11), Between(11, 55)] },
];
