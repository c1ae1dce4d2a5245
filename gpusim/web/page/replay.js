// Replays exported recordings on WebGPU: buffers, shaders, uniforms; it knows nothing of cameras.
"use strict";

class Replay {
  constructor(device, bundle) {
    this.device = device;
    this.bundle = bundle;
    this.held = new Map(); // data by number
    this.ready = new Map(); // programs by number
    this.pipelines = new Map();
    this.last = Promise.resolve();
  }

  static async on(bundle) {
    if (!navigator.gpu) throw new Error("this browser has no WebGPU");
    const adapter = await navigator.gpu.requestAdapter();
    if (!adapter) throw new Error("WebGPU finds no adapter");
    const device = await adapter.requestDevice();
    device.addEventListener("uncapturederror", (event) => console.error(event.error.message));
    return new Replay(device, bundle);
  }

  data(number) {
    if (!this.held.has(number)) {
      const text = atob(this.bundle.data[number]);
      const bytes = new Uint8Array(text.length);
      for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
      this.held.set(number, bytes);
    }
    return this.held.get(number);
  }

  async pipeline(step) {
    const key = JSON.stringify([step.shader, step.constants]);
    if (!this.pipelines.has(key)) {
      const device = this.device;
      const visibility = GPUShaderStage.COMPUTE;
      const entries = [{ binding: 0, visibility, buffer: { type: "uniform" } }];
      for (const [binding, , type] of step.bound) entries.push({ binding, visibility, buffer: { type } });
      const layout = device.createBindGroupLayout({ entries });
      const module = device.createShaderModule({ code: this.bundle.shaders[step.shader] });
      const pipeline = await device.createComputePipelineAsync({
        layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
        compute: { module, entryPoint: "main", constants: step.constants },
      });
      this.pipelines.set(key, { layout, pipeline });
    }
    return this.pipelines.get(key);
  }

  // Buffers, pipelines and bind groups of a program; what it writes is written once.
  async prepare(number) {
    if (this.ready.has(number)) return this.ready.get(number);
    const device = this.device;
    const program = this.bundle.programs[number];
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC | GPUBufferUsage.COPY_DST;
    const buffers = program.buffers.map((bytes) => device.createBuffer({ size: Math.max(bytes, 4), usage }));
    let size = 256;
    const runs = [];
    for (const step of program.steps) {
      if (step.do === "write") device.queue.writeBuffer(buffers[step.buffer], 0, this.data(step.data));
      if (step.do === "run") size = Math.max(size, step.offset + 256 * Math.ceil(step.size / 256));
    }
    const uniforms = device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    for (const step of program.steps) {
      if (step.do !== "run") continue;
      const { layout, pipeline } = await this.pipeline(step);
      const entries = [{ binding: 0, resource: { buffer: uniforms, offset: step.offset, size: step.size } }];
      for (const [binding, buffer] of step.bound) entries.push({ binding, resource: { buffer: buffers[buffer] } });
      runs.push({ pipeline, group: device.createBindGroup({ layout, entries }), groups: step.groups });
    }
    const made = { program, buffers, uniforms, runs };
    this.ready.set(number, made);
    return made;
  }

  // Runs a program, one after another; `frame`: the number of the frame; `given`: buffer and bytes that it reads.
  run(number, params, frame = 0, given = []) {
    const turn = this.last.then(() => this.once(number, params, frame, given));
    this.last = turn.catch(() => {});
    return turn;
  }

  async once(number, params, frame, given) {
    const device = this.device;
    const { program, buffers, uniforms, runs } = await this.prepare(number);
    const words = this.data(params).slice();
    const view = new DataView(words.buffer);
    for (const at of program.frames) view.setUint32(at, frame, true);
    device.queue.writeBuffer(uniforms, 0, words);
    for (const [buffer, bytes] of given) device.queue.writeBuffer(buffers[buffer], 0, bytes);
    const encoder = device.createCommandEncoder();
    let next = 0;
    let staging = null;
    for (const step of program.steps) {
      if (step.do === "clear") encoder.clearBuffer(buffers[step.buffer]);
      if (step.do === "run") {
        const { pipeline, group, groups } = runs[next++];
        const pass = encoder.beginComputePass();
        pass.setPipeline(pipeline);
        pass.setBindGroup(0, group);
        pass.dispatchWorkgroups(...groups);
        pass.end();
      }
      if (step.do === "read") {
        const size = program.buffers[step.buffer];
        staging = device.createBuffer({ size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
        encoder.copyBufferToBuffer(buffers[step.buffer], 0, staging, 0, size);
      }
    }
    device.queue.submit([encoder.finish()]);
    await staging.mapAsync(GPUMapMode.READ);
    const found = new Uint32Array(staging.getMappedRange().slice(0));
    staging.destroy();
    return found;
  }
}

// A camera: raws and pictures by its settings.
class Camera {
  constructor(replay) {
    this.replay = replay;
    this.bundle = replay.bundle;
    const develop = this.bundle.develop;
    const words = (number) => new Uint32Array(replay.data(number).buffer);
    this.rowsOf = words(develop.rows_of);
    this.colsOf = words(develop.cols_of);
  }

  // Codes (rows, cols) of a frame; `noise` 0 or 1, `iso` and `exposure` by their numbers.
  raw(noise, iso, exposure, frame) {
    const state = this.bundle.states[noise][iso][exposure];
    return this.replay.run(state.program, state.params, frame);
  }

  // Red, green, blue and 255 of each pixel of the lit area.
  async picture(raw) {
    const { program, params, codes, top, left, rows, cols } = this.bundle.develop;
    const [high, wide] = [this.rowsOf.length, this.colsOf.length];
    const padded = new Uint16Array(high * wide);
    for (let row = 0; row < high; row++) {
      const from = this.rowsOf[row] * this.bundle.cols;
      for (let col = 0; col < wide; col++) padded[row * wide + col] = raw[from + this.colsOf[col]];
    }
    const found = await this.replay.run(program, params, 0, [[codes, padded]]);
    const pixels = new Uint32Array(rows * cols);
    for (let row = 0; row < rows; row++) {
      const from = (row + top) * wide + left;
      pixels.set(found.subarray(from, from + cols), row * cols);
    }
    for (let i = 0; i < pixels.length; i++) pixels[i] |= 0xff000000;
    return new ImageData(new Uint8ClampedArray(pixels.buffer), cols, rows);
  }
}
