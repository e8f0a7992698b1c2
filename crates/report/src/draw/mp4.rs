//! Videos as MP4 (H.264), with the feature `mp4`.

#[cfg(feature = "mp4")]
pub(super) use filmed::Mp4;

/// Largest sides that the encoder accepts, the longer first.
const LARGEST: [usize; 2] = [3840, 2160];
const SMALLEST: usize = 16;

/// Returns why there is no MP4 next to the GIF for frames of a size (width, height), or `None` if there is one.
pub fn without_mp4((width, height): (usize, usize)) -> Option<String> {
    if cfg!(not(feature = "mp4")) {
        return Some("no MP4, only GIFs: this augnerf was built without the feature mp4".into());
    }
    let sides = [even(width), even(height)];
    let fits = sides[0].max(sides[1]) <= LARGEST[0] && sides[0].min(sides[1]) <= LARGEST[1];
    (!fits).then(|| {
        let [long, short] = LARGEST;
        format!("no MP4, only images and GIFs: its frames have at most {long} x {short} pixels, but these have {width} x {height}")
    })
}

/// Returns the side of a frame, which is even: two pixels share their colours.
fn even(side: usize) -> usize {
    side.next_multiple_of(2).max(SMALLEST)
}

/// Without the feature no value exists.
#[cfg(not(feature = "mp4"))]
pub(super) enum Mp4 {}

#[cfg(not(feature = "mp4"))]
impl Mp4 {
    pub fn begin(_: (usize, usize), _: usize, _: f64) -> Result<Mp4, String> {
        unreachable!("without_mp4 says so")
    }

    pub fn add(&mut self, _: &crate::base::Image) -> Result<(), String> {
        match *self {}
    }

    pub fn finish(self) -> Result<Vec<u8>, String> {
        match self {}
    }
}

#[cfg(feature = "mp4")]
mod filmed {
    use std::num::NonZeroU32;

    use openh264::OpenH264API;
    use openh264::encoder::{
        BitRate, Complexity, EncodedBitStream, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange,
        RateControlMode, UsageType, VuiConfig,
    };
    use openh264::formats::{RgbSliceU8, YUVBuffer};
    use shiguredo_mp4::boxes::{Avc1Box, AvccBox, SampleEntry, VisualSampleEntryFields};
    use shiguredo_mp4::mux::{Mp4FileMuxer, Mp4FileMuxerOptions, Sample, estimate_maximum_moov_box_size};
    use shiguredo_mp4::{TrackKind, Uint};

    use super::super::pictures::{on_paper, quantise};
    use super::even;
    use crate::base::Image;

    type Encoded<T> = Result<T, String>;

    /// Ticks a second for the times of frames.
    const TICKS: NonZeroU32 = NonZeroU32::new(90_000).expect("not 0");
    /// Quantizers of the finest and coarsest blocks, with hardly any visible loss.
    const QUANTISERS: (u8, u8) = (14, 22);
    /// Most frames between two key frames.
    const BETWEEN_KEYS: u32 = 30;
    /// Kinds of units in a stream: parameters of the sequence and of images.
    const SEQUENCE: u8 = 7;
    const PICTURE: u8 = 8;

    /// An MP4 that any browser plays: H.264 at constant quality, 4:2:0, BT.601 colours. If a side is odd, its last
    /// column or row occurs twice.
    pub struct Mp4 {
        encoder: Encoder,
        video: Container,
        /// Size of the frames as they come.
        first: (usize, usize),
        fps: f64,
        count: usize,
    }

    impl Mp4 {
        /// Starts a video of `frames` frames of a size (width, height), at most [`LARGEST`](super::LARGEST).
        pub fn begin(first: (usize, usize), frames: usize, fps: f64) -> Encoded<Mp4> {
            let size = [even(first.0), even(first.1)];
            let encoder = encoder(size, fps).map_err(|e| e.to_string())?;
            Ok(Mp4 { encoder, video: Container::new(size, frames)?, first, fps, count: 0 })
        }

        pub fn add(&mut self, frame: &Image) -> Encoded<()> {
            let (first, size) = (self.first, self.video.size);
            if (frame.width, frame.height) != first {
                return Err(format!(
                    "a frame has {}x{} pixels, but the first has {}x{}",
                    frame.width, frame.height, first.0, first.1
                ));
            }
            let rgb = padded(frame, size);
            let picture = YUVBuffer::from_rgb8_source(RgbSliceU8::new(&rgb, (size[0], size[1])));
            let stream = self.encoder.encode(&picture).map_err(|e| e.to_string())?;
            let start = |index: usize| (index as f64 * f64::from(TICKS.get()) / self.fps).round() as u64;
            let ticks = u32::try_from(start(self.count + 1) - start(self.count)).map_err(|e| e.to_string())?;
            self.count += 1;
            self.video.add(&stream, ticks)
        }

        /// Returns the bytes of the file.
        pub fn finish(self) -> Encoded<Vec<u8>> {
            self.video.finish()
        }
    }

    /// One thread and no skipped frame, so that the bytes are the same each time.
    fn encoder([width, height]: [usize; 2], fps: f64) -> Result<Encoder, openh264::Error> {
        let rate = (width * height) as f64 * fps.max(1.0) * 4.0;
        let config = EncoderConfig::new()
            .usage_type(UsageType::CameraVideoRealTime)
            .rate_control_mode(RateControlMode::Bufferbased)
            .bitrate(BitRate::from_bps(rate.min(1e9) as u32))
            .qp(QpRange::new(QUANTISERS.0, QUANTISERS.1))
            .max_frame_rate(FrameRate::from_hz(fps.max(1.0) as f32))
            .complexity(Complexity::High)
            .intra_frame_period(IntraFramePeriod::from_num_frames(BETWEEN_KEYS))
            .skip_frames(false)
            .scene_change_detect(false)
            .background_detection(false)
            .num_threads(1)
            .vui(VuiConfig::bt601());
        Encoder::with_api_config(OpenH264API::from_source(), config)
    }

    /// Returns 8-bit RGB; the last column and row are repeated to fill the size.
    fn padded(frame: &Image, [width, height]: [usize; 2]) -> Vec<u8> {
        let rgb = quantise(&on_paper(frame));
        let mut bytes = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            for x in 0..width {
                let at = (y.min(frame.height - 1) * frame.width + x.min(frame.width - 1)) * 3;
                bytes.extend_from_slice(&rgb[at..at + 3]);
            }
        }
        bytes
    }

    /// A file that grows frame by frame.
    struct Container {
        bytes: Vec<u8>,
        muxer: Mp4FileMuxer,
        size: [usize; 2],
        begun: bool,
    }

    impl Container {
        fn new(size: [usize; 2], frames: usize) -> Encoded<Container> {
            // The description of the frames comes first, so that a video plays while it loads.
            let reserved_moov_box_size = estimate_maximum_moov_box_size(&[frames]);
            let options = Mp4FileMuxerOptions { reserved_moov_box_size, ..Mp4FileMuxerOptions::default() };
            let muxer = Mp4FileMuxer::with_options(options).map_err(|e| e.to_string())?;
            Ok(Container { bytes: muxer.initial_boxes_bytes().to_vec(), muxer, size, begun: false })
        }

        fn add(&mut self, stream: &EncodedBitStream, duration: u32) -> Encoded<()> {
            let (mut parameters, data_offset) = ([Vec::new(), Vec::new()], self.bytes.len());
            let layers = (0..stream.num_layers()).filter_map(|i| stream.layer(i));
            for layer in layers {
                for unit in (0..layer.nal_count()).filter_map(|i| layer.nal_unit(i)) {
                    let unit = without_start(unit);
                    match unit.first().map(|byte| byte & 0x1f) {
                        Some(SEQUENCE) => parameters[0].push(unit.to_vec()),
                        Some(PICTURE) => parameters[1].push(unit.to_vec()),
                        _ => {
                            self.bytes.extend((unit.len() as u32).to_be_bytes());
                            self.bytes.extend_from_slice(unit);
                        }
                    }
                }
            }
            let sample = Sample {
                track_kind: TrackKind::Video,
                sample_entry: if self.begun { None } else { Some(self.entry(parameters)?) },
                keyframe: stream.frame_type() == FrameType::IDR,
                timescale: TICKS,
                duration,
                composition_time_offset: None,
                data_offset: data_offset as u64,
                data_size: self.bytes.len() - data_offset,
            };
            self.begun = true;
            self.muxer.append_sample(&sample).map_err(|e| e.to_string())
        }

        /// Returns how the frames are decoded.
        fn entry(&self, [sps_list, pps_list]: [Vec<Vec<u8>>; 2]) -> Encoded<SampleEntry> {
            let Some(&[_, profile, compatibility, level, ..]) = sps_list.first().map(Vec::as_slice) else {
                return Err("the encoder started without the parameters of its stream".into());
            };
            // Values that baseline and main profile do not write: 4:2:0, 8 bits.
            let is_high = !matches!(profile, 66 | 77 | 88);
            let visual = VisualSampleEntryFields {
                data_reference_index: VisualSampleEntryFields::DEFAULT_DATA_REFERENCE_INDEX,
                width: self.size[0] as u16,
                height: self.size[1] as u16,
                horizresolution: VisualSampleEntryFields::DEFAULT_HORIZRESOLUTION,
                vertresolution: VisualSampleEntryFields::DEFAULT_VERTRESOLUTION,
                frame_count: VisualSampleEntryFields::DEFAULT_FRAME_COUNT,
                compressorname: VisualSampleEntryFields::NULL_COMPRESSORNAME,
                depth: VisualSampleEntryFields::DEFAULT_DEPTH,
            };
            let avcc_box = AvccBox {
                avc_profile_indication: profile,
                profile_compatibility: compatibility,
                avc_level_indication: level,
                length_size_minus_one: Uint::new(3),
                sps_list,
                pps_list,
                chroma_format: is_high.then(|| Uint::new(1)),
                bit_depth_luma_minus8: is_high.then(|| Uint::new(0)),
                bit_depth_chroma_minus8: is_high.then(|| Uint::new(0)),
                sps_ext_list: Vec::new(),
            };
            Ok(SampleEntry::Avc1(Avc1Box { visual, avcc_box, unknown_boxes: Vec::new() }))
        }

        fn finish(mut self) -> Encoded<Vec<u8>> {
            let finished = self.muxer.finalize().map_err(|e| e.to_string())?;
            for (offset, bytes) in finished.offset_and_bytes_pairs() {
                let (start, end) = (offset as usize, offset as usize + bytes.len());
                self.bytes.resize(self.bytes.len().max(end), 0);
                self.bytes[start..end].copy_from_slice(bytes);
            }
            Ok(self.bytes)
        }
    }

    /// Returns a unit without its prefix 00 00 01.
    fn without_start(unit: &[u8]) -> &[u8] {
        let zeros = unit.iter().take_while(|byte| **byte == 0).count();
        if unit.get(zeros) == Some(&1) { &unit[zeros + 1..] } else { unit }
    }

    #[cfg(test)]
    mod tests {
        use openh264::decoder::Decoder;
        use openh264::formats::YUVSource;
        use shiguredo_mp4::demux::{Input, Mp4FileDemuxer};

        use super::super::without_mp4;
        use super::*;

        fn video(frames: &[Image], fps: f64) -> Encoded<Vec<u8>> {
            let mut video = Mp4::begin((frames[0].width, frames[0].height), frames.len(), fps)?;
            frames.iter().try_for_each(|frame| video.add(frame))?;
            video.finish()
        }

        /// A disc that moves over a gradient.
        fn frame(width: usize, height: usize, t: f64) -> Image {
            let pixels = (0..width * height).flat_map(|i| {
                let (x, y) = ((i % width) as f64 / width as f64, (i / width) as f64 / height as f64);
                let disc = 1.0 / (1.0 + (40.0 * ((x - t).hypot(y - 0.5) - 0.25)).exp());
                [0.2 + 0.6 * x, 0.3 + 0.4 * disc, 0.9 - 0.6 * y].map(|v| v as f32)
            });
            Image { width, height, channels: 3, pixels: pixels.collect() }
        }

        /// Returns the frames of a file: size, ticks and decoded RGB of each.
        fn play(bytes: &[u8]) -> Vec<(usize, usize, u32, Vec<u8>)> {
            let mut demuxer = Mp4FileDemuxer::new();
            while demuxer.required_input().is_some() {
                demuxer.handle_input(Input { position: 0, data: bytes });
            }
            assert_eq!(demuxer.tracks().unwrap().len(), 1);
            assert_eq!(demuxer.tracks().unwrap()[0].timescale, TICKS);
            let (mut decoder, mut frames) = (Decoder::new().unwrap(), Vec::new());
            let start = [0, 0, 0, 1];
            while let Some(sample) = demuxer.next_sample().unwrap() {
                let mut stream = Vec::new();
                if let Some(SampleEntry::Avc1(entry)) = sample.sample_entry {
                    assert!(sample.keyframe);
                    let parameters = entry.avcc_box.sps_list.iter().chain(&entry.avcc_box.pps_list);
                    parameters.for_each(|unit| stream.extend(start.iter().chain(unit)));
                }
                let mut data = &bytes[sample.data_offset as usize..][..sample.data_size];
                while let Some((length, rest)) = data.split_first_chunk::<4>() {
                    let (unit, rest) = rest.split_at(u32::from_be_bytes(*length) as usize);
                    stream.extend(start.iter().chain(unit));
                    data = rest;
                }
                let picture = decoder.decode(&stream).unwrap().expect("a frame a sample");
                let (width, height) = picture.dimensions();
                let mut rgb = vec![0; width * height * 3];
                picture.write_rgb8(&mut rgb);
                frames.push((width, height, sample.duration, rgb));
            }
            frames
        }

        /// Decoded frames have their number, size, order and times, and look the same; odd and small sizes grow.
        #[test]
        fn films_play_as_they_were_made() {
            let videos = [
                (256, 192, (256, 192), 0.01),
                (64, 48, (64, 48), 0.02),
                (33, 21, (34, 22), 0.04),
                (9, 7, (16, 16), 0.08),
            ];
            for (width, height, expected, most) in videos {
                let frames: Vec<Image> = (0..5).map(|i| frame(width, height, f64::from(i) / 4.0)).collect();
                let bytes = video(&frames, 12.5).unwrap();
                let played = play(&bytes);
                assert_eq!(played.len(), 5);
                for (index, (frame, (w, h, ticks, rgb))) in frames.iter().zip(&played).enumerate() {
                    assert_eq!(((*w, *h), *ticks), (expected, 7200), "frame {index}");
                    let apart = (0..width * height).map(|i| {
                        let at = (i / width * w + i % width) * 3;
                        let c = |c: usize| (f32::from(rgb[at + c]) / 255.0 - frame.pixels[3 * i + c]).abs();
                        f64::from(c(0).max(c(1)).max(c(2)))
                    });
                    let mean = apart.sum::<f64>() / (width * height) as f64;
                    assert!(mean < most, "{width} x {height}, frame {index}: {mean}");
                }
            }
        }

        #[test]
        fn films_are_the_same_bytes_twice() {
            let frames: Vec<Image> = (0..3).map(|i| frame(40, 30, f64::from(i) / 2.0)).collect();
            assert_eq!(video(&frames, 15.0).unwrap(), video(&frames, 15.0).unwrap());
        }

        #[test]
        fn what_is_no_film_is_refused() {
            assert!(video(&[frame(8, 8, 0.0), frame(8, 9, 0.0)], 15.0).unwrap_err().contains("8x9"));
            assert!(without_mp4((3842, 4)).unwrap().contains("3840 x 2160") && without_mp4((4, 3842)).is_some());
            assert!(without_mp4((2400, 2200)).is_some() && without_mp4((2160, 3840)).is_none());
        }
    }
}
