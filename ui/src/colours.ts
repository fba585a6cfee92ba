// Scales of colours.
//
// Purpose: the scale of quality and that of distance, for legends and for the graphics card. Invariant: lightness is monotonic,
// so that a scale is read without telling hues apart. Must not know: what is coloured.

export type Colour = readonly [number, number, number];

export interface Scale {
  /** From the least to the most, 0 to 255. */
  readonly stops: readonly Colour[];
}

/** Dark is bad, light is good: the stops are of matplotlib's viridis, which is in the public domain. */
export const QUALITY: Scale = {
  stops: [
    [68, 1, 84], [71, 45, 123], [59, 82, 139], [44, 114, 142], [33, 145, 140], [40, 174, 128], [94, 201, 98], [173, 220, 48], [253, 231, 37],
  ],
};

/** Light is near, dark is far. */
export const DISTANCE: Scale = {
  stops: [
    [250, 243, 221], [250, 221, 164], [248, 190, 110], [240, 150, 72], [222, 108, 62], [190, 70, 72], [146, 41, 83], [97, 24, 84], [45, 14, 66],
  ],
};

/** For the background of a legend. */
export function gradient(scale: Scale): string {
  return `linear-gradient(to right, ${scale.stops.map((stop) => `rgb(${stop.join(" ")})`).join(", ")})`;
}

/** The stops, four bytes each. */
export function texels(scale: Scale): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(scale.stops.flatMap((stop) => [...stop, 255]));
}
