// Charge-transfer inefficiency by traps, after Massey et al. 2009 and 2014 (MNRAS 401, 371; 439, 887): a packet's cloud of n
// electrons fills the volume V = ((n - notch) / (well - notch))^beta of an element and at once all traps therein; a trap
// gives its electron back after an exponential time, to the packet that is there.
// The elements (sites) that charge is shifted through, towards the read-out before element 0, are taken in groups of
// neighbours, the farthest group first; each packet meets those v sites of a group that lie on its way at once, with the
// cloud that it has half-way through them. Groups of one site are one transfer after the other. Sites that the packets
// before have not seen come with empty traps, so that no electron is lost or made at any size of the groups.
// What is filled is a pile of levels, highest and oldest first: electrons in v sites and unit volume between a level's
// height and that of the next, when it was made. A cloud takes off the levels below its own height. In a pile that is too
// high the two oldest levels become one, which holds what both did.
// Units: electrons; time in transfers. In: charge (rows, cols). Out: arrived (rows, cols); trapped (lines), to which is
// added what the traps of the group hold in the end; levels (DEPTH lines (1 or 2) + 3 lines) vec4f is scratch.
// One group for each dispatch, and some thousand packets: lavapipe ends an invocation's loops after 65535 turns together.
// Dispatch: ceil(lines/64) workgroups of 64, a column each, or a row. Lavapipe, 2 cores: see tools/bench.py cti-trap.

override SPECIES: u32 = 4u;
override DEPTH: u32 = 32u;

struct Params {
    lines: u32,
    line_stride: u32,
    element_stride: u32,
    before: u32,         // sites between packet 0 and the read-out
    first_site: u32,     // of the group
    end_site: u32,
    farthest: u32,       // whether the group is the farthest one
    first_packet: u32,   // of those that come to the group
    begin: u32,          // packets of this dispatch
    end: u32,
    packets: u32,        // in a line
    well_fill_power: f32,
    notch_e: f32,
    depth_e: f32,        // well - notch
    density: vec4f,      // of each species, traps in a site
    rate: vec4f,         // its release, log2(e) / time constant
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> charge: array<f32>;
@group(0) @binding(2) var<storage, read_write> arrived: array<f32>;
@group(0) @binding(3) var<storage, read_write> trapped: array<f32>;
@group(0) @binding(4) var<storage, read_write> levels: array<vec4f>;

const NONE = 2.0;   // above all volumes: no level is left

struct Level {
    height: f32,
    made: f32,    // when
    held: vec4f,  // then
}

var<private> line: u32;
var<private> oldest: u32;   // where the pile begins, in a ring
var<private> count: u32;

fn slot(i: u32) -> u32 {
    return (((oldest + i) % DEPTH) * params.lines + line) * select(1u, 2u, SPECIES > 2u);
}

// Where a line's pile and electrons are kept between dispatches.
fn state_slot() -> u32 {
    return DEPTH * params.lines * select(1u, 2u, SPECIES > 2u) + 3u * line;
}

fn level(i: u32) -> Level {
    let at = slot(i);
    let first = levels[at];
    var others = vec2f(0.0);
    if (SPECIES > 2u) {
        others = levels[at + 1u].xy;
    }
    return Level(first.x, first.y, vec4f(first.zw, others));
}

fn put(i: u32, one: Level) {
    let at = slot(i);
    levels[at] = vec4f(one.height, one.made, one.held.xy);
    if (SPECIES > 2u) {
        levels[at + 1u] = vec4f(one.held.zw, 0.0, 0.0);
    }
}

fn held_at(one: Level, now: f32) -> vec4f {
    let exponent = (one.made - now) * params.rate;
    var kept = vec4f(0.0);
    kept.x = exp2(exponent.x);
    if (SPECIES > 1u) {
        kept.y = exp2(exponent.y);
    }
    if (SPECIES > 2u) {
        kept.z = exp2(exponent.z);
        kept.w = exp2(exponent.w);
    }
    return one.held * kept;
}

fn volume(electrons: f32) -> f32 {
    let fill = clamp((electrons - params.notch_e) / params.depth_e, 0.0, 1.0);
    return select(0.0, pow(fill, params.well_fill_power), fill > 0.0);
}

// What a packet brings to the group: one of the group's own sites, or of none, comes for the first time.
fn charge_of(packet: u32) -> f32 {
    let at = line * params.line_stride + packet * params.element_stride;
    if (packet + params.before < params.end_site || params.farthest == 1u) {
        return charge[at];
    }
    return arrived[at];
}

// Make one level of the two oldest.
fn merge(now: f32) {
    let next = level(2u).height;
    let first = level(0u);
    let second = level(1u);
    let sum = (first.height - second.height) * held_at(first, now) + (second.height - next) * held_at(second, now);
    put(1u, Level(first.height, now, sum / (first.height - next)));
    oldest = (oldest + 1u) % DEPTH;
    count -= 1u;
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    line = id.x;
    if (line >= params.lines) {
        return;
    }
    let kept = exp2(-params.rate);
    var top = Level(NONE, 0.0, vec4f(0.0));
    var held = vec4f(0.0);   // of each species, in all sites of the group
    if (params.begin > params.first_packet) {
        let state = state_slot();
        let pile = levels[state];
        oldest = u32(pile.x);
        count = u32(pile.y);
        top = Level(pile.z, pile.w, levels[state + 1u]);
        held = levels[state + 2u];
    }
    var next = charge_of(params.begin);
    for (var packet = params.begin; packet < params.end; packet++) {
        let at = line * params.line_stride + packet * params.element_stride;
        let now = f32(packet - params.first_packet);
        let site = packet + params.before;
        var free = next;   // loaded one turn ahead: in frames the next packet is far away in memory
        if (packet + 1u < params.end) {
            next = charge_of(packet + 1u);
        }
        let passed = f32(min(site + 1u, params.end_site) - params.first_site);
        let released = dot(params.density, held * (1.0 - kept));
        held *= kept;
        let height = volume(free + released * (0.5 + 0.5 / passed));
        free += released;
        if (height > 0.0) {
            var below = vec4f(0.0);
            var low = 0.0;
            while (top.height <= height) {
                below += (top.height - low) * held_at(top, now);
                low = top.height;
                top = Level(NONE, 0.0, vec4f(0.0));
                if (count > 0u) {
                    count -= 1u;
                    top = level(count);
                }
            }
            below += (height - low) * held_at(top, now);
            let room = max(passed * height - below, vec4f(0.0));
            let wanted = dot(params.density, room);
            let taken = min(wanted, max(free, 0.0));   // there may be fewer electrons than traps
            let share = select(1.0, taken / wanted, taken < wanted);
            free -= taken;
            held += share * room;
            if (top.height < NONE) {
                if (count == DEPTH) {
                    merge(now);
                }
                put(count, top);
                count += 1u;
            }
            top = Level(height, now, (below + share * room) / height);
        }
        arrived[at] = free;
    }
    let state = state_slot();
    levels[state] = vec4f(f32(oldest), f32(count), top.height, top.made);
    levels[state + 1u] = top.held;
    levels[state + 2u] = held;
    if (params.end == params.packets) {
        trapped[line] += dot(params.density, held);
    }
}
