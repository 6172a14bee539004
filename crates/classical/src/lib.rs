//! Classical optical flow: Gunnar Farneback and TV-L1, with the parameters of OpenCV.
