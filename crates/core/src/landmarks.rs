//! Numbers of facial landmarks.

/// The vertices of MediaPipe's face mesh that are nearest to dlib's landmarks, in dlib's order; the correspondence that is in
/// common use (e.g. `latentsync/utils/image_processor.py` of LatentSync). Those of the jaw and of the brows are approximate.
pub const MEDIAPIPE_OF_DLIB: [usize; 68] = [
    162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389, // jaw
    71, 63, 105, 66, 107, 336, 296, 334, 293, 301, // brows
    168, 197, 5, 4, 75, 97, 2, 326, 305, // nose
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380, // eyes
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181, // outer lips
    78, 82, 13, 312, 308, 317, 14, 87, // inner lips
];
