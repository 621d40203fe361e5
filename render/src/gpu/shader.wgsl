// What a front looks like. The vertex shader fetches the corners of triangles, and their vertices, out of the copies of the
// navigator's streams. In place of the line COLOURS stand those that pictures by the processor have, too; in place of the line
// PARTS how to get at the parts that vertices are divided into.

struct View {
    // The eye, relative to the model's origin, as a sum of two: what is near it is at its exact place.
    eye: vec4<f32>,
    eye_rest: vec4<f32>,
    // In diagonals of the model; the first two as long as one over the tangent of half the angle of view.
    right: vec4<f32>,
    up: vec4<f32>,
    // w: the least depth that is drawn, in diagonals.
    forward: vec4<f32>,
    // To the light.
    light: vec4<f32>,
    // What is to be seen: edges, levels, morphs; and what corners carry: 1 wedges, 2 each its own.
    flags: vec4<u32>,
}

struct Seen {
    @builtin(position) place: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) surface: vec3<f32>,
    @location(2) shares: vec3<f32>,
    @location(3) texture: vec2<f32>,
    // Counted from 1; 0: none.
    @location(4) @interpolate(flat) layer: u32,
}

//COLOURS//

// Whether the device itself turns parts of light into what is stored.
override is_turned_by_device: bool = false;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> level_colours: array<vec4<f32>, 64>;
@group(0) @binding(2) var textures: texture_2d_array<f32>;
@group(0) @binding(3) var texture_sampler: sampler;
// Colours of materials; w: the texture, counted from 1; 0: none. The first is that of a surface without a material.
@group(0) @binding(4) var<storage, read> materials: array<vec4<f32>>;
@group(1) @binding(0) var<storage, read> triangles: array<u32>;
@group(1) @binding(1) var<storage, read> corners: array<u32>;
@group(2) @binding(0) var<storage, read> levels: array<u32>;
//PARTS//

// The decoded normal (vdt/src/tree/normals.rs).
fn normal_of(word: u32) -> vec3<f32> {
    let square = vec2<f32>(f32(word & 1023u), f32(word >> 10u & 1023u)) - 511.0;
    let z = 511.0 - abs(square.x) - abs(square.y);
    let folded = (511.0 - abs(square.yx)) * select(vec2<f32>(1.0), vec2<f32>(-1.0), square < vec2<f32>(0.0));
    return normalize(vec3<f32>(select(square, folded, z < 0.0), z));
}

struct Wedge {
    colour: u32,
    texture: vec2<u32>,
    material: u32,
    normal: u32,
}

// The part of the light that is stored so.
fn light_of(stored: vec3<f32>) -> vec3<f32> {
    let curved = pow((stored + 0.055) / 1.055, vec3<f32>(2.4));
    return select(curved, stored / 12.92, stored <= vec3<f32>(0.04045));
}

fn place_of(to_place: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(dot(view.right.xyz, to_place), dot(view.up.xyz, to_place), view.forward.w, dot(view.forward.xyz, to_place));
}

@vertex
fn corner(@builtin(vertex_index) index: u32) -> Seen {
    let number = triangles[index];
    let vertex = vertex_at(number);
    var position = bitcast<vec3<f32>>(vertex.xyz);
    if view.flags.z != 0u {
        let morph = bitcast<vec4<f32>>(morph_at(number));
        if morph.w < 1.0 {
            position = morph.xyz + morph.w * (position - morph.xyz);
        }
    }
    var seen: Seen;
    seen.place = place_of((position - view.eye.xyz) - view.eye_rest.xyz);
    seen.normal = normal_of(vertex.w);
    seen.surface = PLAIN;
    seen.texture = vec2<f32>(0.0);
    seen.layer = 0u;
    if view.flags.w != 0u {
        var wedge = number;
        if view.flags.w == 2u {
            wedge = corners[index];
        }
        let words = wedge_at(wedge);
        let look = materials[min(words.material, arrayLength(&materials) - 1u)];
        seen.normal = normal_of(words.normal);
        seen.surface = light_of(unpack4x8unorm(words.colour).xyz) * look.xyz;
        seen.texture = bitcast<vec2<f32>>(words.texture);
        seen.layer = u32(look.w);
    }
    if view.flags.y != 0u {
        seen.surface = level_colours[levels[number >> 2u] >> (8u * (number & 3u)) & 63u].xyz;
    }
    if view.flags.y != 0u {
        seen.layer = 0u;
    }
    seen.shares = vec3<f32>(0.0);
    seen.shares[index % 3u] = 1.0;
    return seen;
}

fn stored(light: vec3<f32>) -> vec3<f32> {
    let linear = clamp(light, vec3<f32>(0.0), vec3<f32>(1.0));
    if is_turned_by_device {
        return linear;
    }
    let curved = 1.055 * pow(linear, vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(curved, 12.92 * linear, linear <= vec3<f32>(0.0031308));
}

@fragment
fn surface(seen: Seen, @builtin(front_facing) is_outer_side: bool) -> @location(0) vec4<f32> {
    // The first row is at the top, where v is 1.
    let place = vec2<f32>(seen.texture.x, 1.0 - seen.texture.y);
    let image = textureSample(textures, texture_sampler, place, max(seen.layer, 1u) - 1u).xyz;
    var part = select(seen.surface, seen.surface * image, seen.layer > 0u);
    if view.flags.x != 0u {
        let steps = vec3<f32>(
            length(vec2<f32>(dpdx(seen.shares.x), dpdy(seen.shares.x))),
            length(vec2<f32>(dpdx(seen.shares.y), dpdy(seen.shares.y))),
            length(vec2<f32>(dpdx(seen.shares.z), dpdy(seen.shares.z))),
        );
        if any(seen.shares <= EDGE_WIDTH * steps) {
            part = EDGE;
        }
    }
    let normal = select(-1.0, 1.0, is_outer_side) * seen.normal;
    let length = max(length(normal), 1e-20);
    let direct = max(dot(normal / length, view.light.xyz), 0.0);
    return vec4<f32>(stored(part * (AMBIENT + (1.0 - AMBIENT) * direct)), 1.0);
}

struct Line {
    @builtin(position) place: vec4<f32>,
    @location(0) colour: vec4<f32>,
}

@vertex
fn line_end(@location(0) position: vec3<f32>, @location(1) colour: vec4<f32>) -> Line {
    return Line(place_of((position - view.eye.xyz) - view.eye_rest.xyz), colour);
}

@fragment
fn line(line: Line) -> @location(0) vec4<f32> {
    return vec4<f32>(stored(line.colour.xyz), 1.0);
}

// All of a view's part of the picture, behind everything.
@vertex
fn cover_corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index % 2u) * 4.0 - 1.0, f32(index / 2u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn cover() -> @location(0) vec4<f32> {
    if is_turned_by_device {
        return vec4<f32>(light_of(BACKGROUND), 1.0);
    }
    return vec4<f32>(BACKGROUND, 1.0);
}
