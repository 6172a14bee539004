//! The parts of a face that have names, by dlib's 68 points. `left` is the left of the picture.

use super::Corner::{At, Between, Off};
use super::Region;

#[rustfmt::skip]
pub(super) const REGIONS: [Region; 16] = [
    Region { name: "forehead", corners: &[Off(18, [0.0, -0.12]), Off(18, [0.0, -0.32]), Off(25, [0.0, -0.32]), Off(25, [0.0, -0.12])] },
    Region { name: "brow-left", corners: &[Off(17, [0.0, 0.02]), Off(17, [0.0, -0.1]), Off(19, [0.0, -0.12]), Off(21, [0.0, -0.12]), Off(21, [0.0, 0.02])] },
    Region { name: "brow-right", corners: &[Off(26, [0.0, 0.02]), Off(26, [0.0, -0.1]), Off(24, [0.0, -0.12]), Off(22, [0.0, -0.12]), Off(22, [0.0, 0.02])] },
    Region { name: "glabella", corners: &[Off(21, [0.0, -0.12]), Off(22, [0.0, -0.12]), At(21), At(22), At(27)] },
    Region { name: "eye-left", corners: &[Off(36, [-0.04, 0.0]), Off(37, [0.0, -0.08]), Off(38, [0.0, -0.08]), Off(39, [0.03, 0.0]), Off(40, [0.0, 0.07]), Off(41, [0.0, 0.07])] },
    Region { name: "eye-right", corners: &[Off(45, [0.04, 0.0]), Off(44, [0.0, -0.08]), Off(43, [0.0, -0.08]), Off(42, [-0.03, 0.0]), Off(47, [0.0, 0.07]), Off(46, [0.0, 0.07])] },
    Region { name: "cheek-left", corners: &[Between(1, 36), Off(40, [0.0, 0.12]), Off(31, [-0.06, 0.0]), Off(48, [-0.1, -0.1]), Between(3, 48), At(2)] },
    Region { name: "cheek-right", corners: &[Between(15, 45), Off(47, [0.0, 0.12]), Off(35, [0.06, 0.0]), Off(54, [0.1, -0.1]), Between(13, 54), At(14)] },
    Region { name: "nose", corners: &[At(27), Off(31, [-0.05, -0.03]), Off(35, [0.05, -0.03]), Off(31, [-0.02, 0.03]), Off(35, [0.02, 0.03]), At(33)] },
    Region { name: "nostril-left", corners: &[Off(31, [-0.08, -0.1]), Off(31, [0.02, -0.1]), Off(31, [0.02, 0.04]), Off(31, [-0.08, 0.04])] },
    Region { name: "nostril-right", corners: &[Off(35, [0.08, -0.1]), Off(35, [-0.02, -0.1]), Off(35, [-0.02, 0.04]), Off(35, [0.08, 0.04])] },
    Region { name: "upper-lip", corners: &[At(48), Off(50, [0.0, -0.05]), Off(52, [0.0, -0.05]), At(54), At(62)] },
    Region { name: "lower-lip", corners: &[At(48), At(54), At(66), Off(56, [0.0, 0.04]), Off(58, [0.0, 0.04])] },
    Region { name: "mouth-corner-left", corners: &[Off(48, [-0.1, -0.09]), Off(48, [0.04, -0.09]), Off(48, [0.04, 0.09]), Off(48, [-0.1, 0.09])] },
    Region { name: "mouth-corner-right", corners: &[Off(54, [0.1, -0.09]), Off(54, [-0.04, -0.09]), Off(54, [-0.04, 0.09]), Off(54, [0.1, 0.09])] },
    Region { name: "chin", corners: &[Off(59, [0.0, 0.08]), Off(55, [0.0, 0.08]), At(10), At(8), At(6)] },
];
