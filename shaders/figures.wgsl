// Adds the workgroups' parts up.

#import shared/motion

@group(0) @binding(0) var<uniform> motion: Motion;
@group(0) @binding(1) var<storage, read> tallies: array<Figures>;
@group(0) @binding(2) var<storage, read_write> figures: Figures;

#import shared/tally

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32) {
    var own = Figures();
    for (var k = lane; k < motion.groups; k += 64u) {
        own = both(own, tallies[k]);
    }
    add_up(lane, own);
    if lane == 0u {
        figures = part[0];
    }
}
