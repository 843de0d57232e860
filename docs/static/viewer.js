/* Turns a part in a page: WebGL 2, no library, no network.

A page has <figure class="part-view" data-model="NAME"><img ...></figure> and, after this script, NAME.js, which calls
showPart("NAME", model). A model is {low, step, parts: [{name, colour, vertices, triangles, edges}], data}: `data` is base64 of
gzip of a stream of bytes that benchmarks/view_files.py writes. A part with `edges` has flat triangles, whose sides are drawn.
Without WebGL 2 the picture stays. */
"use strict";

const VERTEX = `#version 300 es
uniform mat4 camera; uniform mat3 turn; in vec3 place, normal, corner; out vec3 at, facing, share;
void main() { at = place; facing = turn * normal; share = corner; gl_Position = camera * vec4(place, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 colour; uniform vec4 plane; uniform bool edges; in vec3 at, facing, share; out vec4 shown;
void main() {
    vec3 pixels = share / max(fwidth(share), vec3(1e-9));
    if (dot(plane.xyz, at) > plane.w) discard;
    vec3 n = normalize(facing);
    float light = 0.34 + 0.56 * max(dot(n, normalize(vec3(0.35, 0.55, 0.75))), 0.0) + 0.12 * max(dot(n, vec3(-0.8, 0.1, 0.5)), 0.0);
    shown = gl_FrontFacing ? vec4(colour * light, 1.0) : vec4(colour * vec3(0.85, 0.72, 0.66), 1.0);
    if (edges) shown.rgb *= 0.35 + 0.65 * smoothstep(0.3, 1.2, min(pixels.x, min(pixels.y, pixels.z)));
}`;

const ISO = { turn: 0.61, tilt: 0.45, zoom: 1, shift: [0, 0] };

async function inflate(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

/* Points and triangles of every part. Coordinates are differences to the point before, indices are counted down from the
smallest index not used yet; low bytes come before high ones. */
function unpack(model, bytes) {
    let at = 0;
    const numbers = (count, width) => {
        const values = new Uint32Array(count);
        for (let byte = 0; byte < width; byte++) for (let i = 0; i < count; i++) values[i] |= bytes[at++] << (8 * byte);
        return values;
    };
    return model.parts.map((part) => {
        const points = new Float32Array(3 * part.vertices);
        for (let axis = 0; axis < 3; axis++) {
            let sum = 0;
            numbers(part.vertices, 2).forEach((step, i) => {
                sum = (sum + step) & 0xffff;
                points[3 * i + axis] = model.low[axis] + model.step * sum;
            });
        }
        let fresh = 0;
        const corners = numbers(3 * part.triangles, 3).map((back) => (back ? fresh - back : fresh++));
        return part.edges ? separate(part, points, corners) : { ...part, points, corners, normals: pointNormals(points, corners) };
    });
}

/* The part with points of its own for each triangle, and the shares of its corners at them. */
function separate(part, points, corners) {
    const own = Float32Array.from({ length: 3 * corners.length }, (_, i) => points[3 * corners[Math.floor(i / 3)] + (i % 3)]);
    const numbers = corners.map((_, i) => i);
    const shares = Float32Array.from({ length: own.length }, (_, i) => (Math.floor(i / 3) % 3 === i % 3 ? 1 : 0));
    return { ...part, points: own, corners: numbers, normals: pointNormals(own, numbers), shares };
}

function pointNormals(points, corners) {
    const normals = new Float32Array(points.length);
    for (let i = 0; i < corners.length; i += 3) {
        const [a, b, c] = [3 * corners[i], 3 * corners[i + 1], 3 * corners[i + 2]];
        const u = [0, 1, 2].map((k) => points[b + k] - points[a + k]), v = [0, 1, 2].map((k) => points[c + k] - points[a + k]);
        const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += n[k];
    }
    return normals;
}

/* The rotation from the part to the eye, its rows right, up and towards the eye; z of the part is up. */
function rotation({ turn, tilt }) {
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    return [[c, s, 0], [-s * st, c * st, ct], [s * ct, -c * ct, st]];
}

class View {
    constructor(figure, model, parts) {
        this.figure = figure;
        this.canvas = document.createElement("canvas");
        this.gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true });
        this.state = structuredClone(ISO);
        this.measure(parts);
        this.parts = parts.map((part) => ({ ...part, ...this.upload(part), hidden: false }));
        this.cut = { axis: parts.length > 1 ? 1 : -1, share: 0.5 }; // domains within each other are shown cut open
        this.canvas.tabIndex = 0;
        this.canvas.setAttribute("role", "img");
        this.canvas.setAttribute("aria-label", figure.querySelector("img")?.alt || "the part");
        figure.querySelector("img")?.remove();
        figure.prepend(this.canvas, this.controls());
        this.listen();
        new ResizeObserver(() => this.draw()).observe(this.canvas);
        this.draw();
    }

    measure(parts) {
        this.low = [Infinity, Infinity, Infinity];
        this.high = [-Infinity, -Infinity, -Infinity];
        for (const { points } of parts)
            for (let i = 0; i < points.length; i++) {
                this.low[i % 3] = Math.min(this.low[i % 3], points[i]);
                this.high[i % 3] = Math.max(this.high[i % 3], points[i]);
            }
        this.middle = this.low.map((low, k) => (low + this.high[k]) / 2);
        this.radius = Math.hypot(...this.low.map((low, k) => this.high[k] - low)) / 2;
    }

    /* Half the height of a window of this shape in which the box of the part fits, seen as at first. */
    fit(shape) {
        const [right, up] = rotation(ISO);
        const half = this.low.map((low, k) => (this.high[k] - low) / 2);
        const span = (row) => row.reduce((sum, value, k) => sum + Math.abs(value) * half[k], 0);
        return 1.06 * Math.max(span(up), span(right) / shape);
    }

    program() {
        const { gl } = this;
        const program = gl.createProgram();
        for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
            const shader = gl.createShader(kind);
            gl.shaderSource(shader, text);
            gl.compileShader(shader);
            gl.attachShader(program, shader);
        }
        gl.linkProgram(program);
        if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
        return program;
    }

    upload({ points, normals, corners, shares }) {
        const { gl } = this;
        this.shaders ??= this.program();
        const array = gl.createVertexArray();
        gl.bindVertexArray(array);
        for (const [name, values] of [["place", points], ["normal", normals], ["corner", shares]]) {
            if (!values) continue;
            const where = gl.getAttribLocation(this.shaders, name);
            gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
            gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
            gl.enableVertexAttribArray(where);
            gl.vertexAttribPointer(where, 3, gl.FLOAT, false, 0, 0);
        }
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
        return { array, count: corners.length };
    }

    draw() {
        this.waiting ??= requestAnimationFrame(() => {
            this.waiting = undefined;
            this.drawNow();
        });
    }

    drawNow() {
        const { gl, canvas, state, radius, middle } = this;
        const scale = window.devicePixelRatio || 1;
        canvas.width = Math.round(canvas.clientWidth * scale);
        canvas.height = Math.round(canvas.clientHeight * scale);
        if (!canvas.width || !canvas.height) return;
        const rows = rotation(state);
        const reach = this.fit(canvas.width / canvas.height) / state.zoom;
        const [x, y, z] = [reach * canvas.width / canvas.height, reach, 4 * radius];
        const camera = new Float32Array(16);
        rows.forEach((row, i) => {
            const size = [x, y, -z][i];
            for (let k = 0; k < 3; k++) camera[4 * k + i] = row[k] / size;
            camera[12 + i] = -row.reduce((sum, value, k) => sum + value * middle[k], 0) / size + (state.shift[i] ?? 0);
        });
        camera[15] = 1;
        gl.viewport(0, 0, canvas.width, canvas.height);
        gl.enable(gl.DEPTH_TEST);
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
        gl.useProgram(this.shaders);
        const uniform = (name) => gl.getUniformLocation(this.shaders, name);
        gl.uniformMatrix4fv(uniform("camera"), false, camera);
        gl.uniformMatrix3fv(uniform("turn"), false, new Float32Array([0, 1, 2].flatMap((k) => rows.map((row) => row[k]))));
        const { axis, share } = this.cut;
        const plane = [0, 0, 0, 1];
        if (axis >= 0) {
            const sign = axis === 1 ? -1 : 1; // what lies towards the first view is taken away
            plane[axis] = sign;
            plane[3] = sign * (this.low[axis] + share * (this.high[axis] - this.low[axis]));
        }
        gl.uniform4f(uniform("plane"), ...plane);
        gl.enable(gl.POLYGON_OFFSET_FILL);
        this.parts.forEach((part, i) => {
            if (part.hidden) return;
            gl.polygonOffset(this.parts.length - i, this.parts.length - i); // of faces that touch, the last part's is seen
            gl.uniform3f(uniform("colour"), ...part.colour);
            gl.uniform1i(uniform("edges"), part.edges ? 1 : 0);
            gl.bindVertexArray(part.array);
            gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_INT, 0);
        });
    }

    controls() {
        const bar = document.createElement("div");
        bar.className = "part-view-bar";
        const cut = document.createElement("select");
        cut.setAttribute("aria-label", "Direction of the cut");
        for (const [value, text] of [[-1, "no cut"], [0, "cut x"], [1, "cut y"], [2, "cut z"]]) cut.add(new Option(text, value));
        const place = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 1, step: 0.005, value: 0.5 });
        place.setAttribute("aria-label", "Place of the cut");
        cut.value = this.cut.axis;
        place.disabled = this.cut.axis < 0;
        cut.oninput = () => {
            this.cut.axis = Number(cut.value);
            place.disabled = this.cut.axis < 0;
            this.draw();
        };
        place.oninput = () => {
            this.cut.share = Number(place.value);
            this.draw();
        };
        bar.append(cut, place);
        if (this.parts.length > 1)
            for (const part of this.parts) {
                const label = document.createElement("label");
                const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
                box.oninput = () => {
                    part.hidden = !box.checked;
                    this.draw();
                };
                const swatch = document.createElement("i");
                swatch.style.background = `rgb(${part.colour.map((value) => Math.round(255 * value))})`;
                label.append(box, swatch, part.name);
                bar.append(label);
            }
        const reset = Object.assign(document.createElement("button"), { type: "button", textContent: "reset" });
        reset.onclick = () => {
            this.state = structuredClone(ISO);
            this.draw();
        };
        bar.append(reset);
        return bar;
    }

    listen() {
        const { canvas, state } = this;
        const held = new Map();
        const turn = (dx, dy) => {
            this.state.turn -= dx;
            this.state.tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.state.tilt + dy));
            this.draw();
        };
        const shift = (dx, dy) => {
            this.state.shift[0] += 2 * dx / canvas.clientWidth;
            this.state.shift[1] -= 2 * dy / canvas.clientHeight;
            this.draw();
        };
        const zoom = (factor) => {
            this.state.zoom = Math.max(0.3, Math.min(40, this.state.zoom * factor));
            this.draw();
        };
        const spread = () => {
            const [a, b] = [...held.values()];
            return Math.hypot(a.x - b.x, a.y - b.y);
        };
        canvas.onpointerdown = (event) => {
            canvas.setPointerCapture(event.pointerId);
            held.set(event.pointerId, { x: event.clientX, y: event.clientY });
        };
        canvas.onpointerup = canvas.onpointercancel = (event) => held.delete(event.pointerId);
        canvas.onpointermove = (event) => {
            const last = held.get(event.pointerId);
            if (!last) return;
            const before = held.size === 2 ? spread() : 0;
            const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
            Object.assign(last, { x: event.clientX, y: event.clientY });
            if (held.size === 2) {
                zoom(spread() / (before || 1));
                shift(dx / 2, dy / 2);
            } else if (event.shiftKey || event.buttons & 2) shift(dx, dy);
            else turn(0.01 * dx, 0.01 * dy);
        };
        canvas.oncontextmenu = (event) => event.preventDefault();
        canvas.addEventListener("wheel", (event) => {
            if (document.activeElement !== canvas) return; // a page that is scrolled past the view goes on scrolling
            event.preventDefault();
            zoom(Math.exp(-0.0015 * event.deltaY));
        }, { passive: false });
        const keys = {
            ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, -0.1),
            ArrowDown: () => turn(0, 0.1), "+": () => zoom(1.15), "-": () => zoom(1 / 1.15),
        };
        canvas.onkeydown = (event) => {
            if (!(event.key in keys)) return;
            event.preventDefault();
            keys[event.key]();
        };
    }
}

async function showPart(name, model) {
    const figure = document.querySelector(`.part-view[data-model="${name}"]`);
    if (!figure || typeof DecompressionStream === "undefined") return;
    if (!document.createElement("canvas").getContext("webgl2")) return;
    new View(figure, model, unpack(model, await inflate(model.data)));
}
