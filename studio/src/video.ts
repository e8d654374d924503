// A take as MP4 or GIF, drawn frame by frame in the browser, so its time is the clip's and not the machine's.

import { ArrayBufferTarget, Muxer } from "mp4-muxer";
import { GIFEncoder, applyPalette, quantize } from "gifenc";
import type { Viewer } from "./viewer";

const CODECS = [
  { codec: "avc1.640028", box: "avc" },
  { codec: "avc1.42001f", box: "avc" },
  { codec: "vp09.00.40.08", box: "vp9" },
  { codec: "av01.0.08M.08", box: "av1" },
] as const;

export interface Shot {
  viewer: Viewer;
  seconds: number;
  told: (done: number) => void;
  stopped: () => boolean;
}

const breath = (): Promise<void> => new Promise((resolve) => setTimeout(resolve));

export async function mp4(shot: Shot, width: number, height: number, fps: number): Promise<Blob> {
  if (typeof VideoEncoder === "undefined") {
    throw new Error("this browser cannot write videos; write a GIF, or use: bunraku render");
  }
  let chosen: (typeof CODECS)[number] | undefined;
  for (const one of CODECS) {
    const answer = await VideoEncoder.isConfigSupported({ codec: one.codec, width, height, bitrate: 8e6, framerate: fps });
    if (answer.supported) {
      chosen = one;
      break;
    }
  }
  if (!chosen) {
    throw new Error("this browser has no encoder for videos; write a GIF, or use: bunraku render");
  }
  const target = new ArrayBufferTarget();
  const muxer = new Muxer({ target, fastStart: "in-memory", video: { codec: chosen.box, width, height, frameRate: fps } });
  let broken: Error | null = null;
  const encoder = new VideoEncoder({
    output: (chunk, meta) => muxer.addVideoChunk(chunk, meta),
    error: (error) => (broken = error),
  });
  encoder.configure({ codec: chosen.codec, width, height, bitrate: 8e6, framerate: fps });
  const frames = Math.max(Math.round(shot.seconds * fps), 1);
  for (let frame = 0; frame < frames; frame += 1) {
    if (broken) {
      throw broken;
    }
    if (shot.stopped()) {
      encoder.close();
      throw new Error("the video was stopped");
    }
    const picture = new VideoFrame(shot.viewer.picture(frame / fps, width, height), {
      timestamp: Math.round((frame * 1e6) / fps),
      duration: Math.round(1e6 / fps),
    });
    encoder.encode(picture, { keyFrame: frame % (2 * fps) === 0 });
    picture.close();
    shot.told((frame + 1) / frames);
    if (encoder.encodeQueueSize > 4 || frame % 4 === 0) {
      await breath();
    }
  }
  await encoder.flush();
  encoder.close();
  muxer.finalize();
  return new Blob([target.buffer], { type: "video/mp4" });
}

export async function gif(shot: Shot, width: number, height: number, fps: number): Promise<Blob> {
  const out = GIFEncoder();
  const flat = document.createElement("canvas");
  flat.width = width;
  flat.height = height;
  const paper = flat.getContext("2d", { willReadFrequently: true });
  if (!paper) {
    throw new Error("this browser cannot draw pictures");
  }
  const frames = Math.max(Math.round(shot.seconds * fps), 1);
  let palette: number[][] | null = null;
  for (let frame = 0; frame < frames; frame += 1) {
    if (shot.stopped()) {
      throw new Error("the GIF was stopped");
    }
    paper.drawImage(shot.viewer.picture(frame / fps, width, height), 0, 0);
    const { data } = paper.getImageData(0, 0, width, height);
    palette ??= quantize(data, 256);
    out.writeFrame(applyPalette(data, palette), width, height, { palette, delay: 1000 / fps });
    shot.told((frame + 1) / frames);
    await breath();
  }
  out.finish();
  return new Blob([out.bytes() as Uint8Array<ArrayBuffer>], { type: "image/gif" });
}
