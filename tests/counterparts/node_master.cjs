// npm's `canopen` as master of node 1 on a loopback bus: `node node_master.cjs PORT`. Prints what it has seen as one JSON
// object. The bus is UDP broadcast of `struct can_frame` on 127.255.255.255 (fffo_drive/can/link.py).
"use strict";

const dgram = require("dgram");
const { EventEmitter } = require("events");
const { createRequire } = require("module");

const PORT = Number(process.argv[2]);
const NODE = 1;
const BROADCAST = "127.255.255.255";
const TIMEOUT_MS = 20000;

function load() {
  const from = createRequire(process.env.COUNTERPARTS_MODULES + "/");
  try {
    from("node-crc");
  } catch {
    // its native part was not built: the one function that is needed of it, CRC-16 of XMODEM
    const crc = (width, reflected, polynomial, initial, ...rest) => {
      let value = initial;
      for (const byte of rest[rest.length - 1]) {
        value ^= byte << 8;
        for (let i = 0; i < 8; i++) value = ((value & 0x8000 ? (value << 1) ^ polynomial : value << 1) & 0xffff);
      }
      return Buffer.from([value >> 8, value & 0xff]);
    };
    const Module = require("module");
    const original = Module._load;
    Module._load = (name, ...rest) => (name === "node-crc" ? { crc } : original(name, ...rest));
  }
  return from("canopen");
}

const { Device, DataType } = load();
const { UNSIGNED8, UNSIGNED16, UNSIGNED32, INTEGER8, INTEGER16, INTEGER32, VISIBLE_STRING } = DataType;

async function openBus(device) {
  const rx = dgram.createSocket({ type: "udp4", reuseAddr: true });
  const tx = dgram.createSocket("udp4");
  await new Promise((resolve) => rx.bind({ address: BROADCAST, port: PORT }, resolve));
  await new Promise((resolve) => tx.bind(0, "127.0.0.1", resolve));
  tx.setBroadcast(true);
  const own = tx.address().port;
  device.addListener("message", ({ id, data }) => {
    const frame = Buffer.alloc(16);
    frame.writeUInt32LE(id, 0);
    frame.writeUInt8(data.length, 4);
    data.copy(frame, 8);
    tx.send(frame, PORT, BROADCAST);
  });
  const frames = new EventEmitter();
  rx.on("message", (frame, sender) => {
    if (sender.port === own) return;
    const message = { id: frame.readUInt32LE(0), len: frame[4], data: Buffer.from(frame.subarray(8, 8 + frame[4])) };
    device.receive(message);
    frames.emit("frame", message);
  });
  return { frames, close: () => (rx.close(), tx.close()) };
}

function once(emitter, event, condition, what) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error(`${what} did not come about`)), TIMEOUT_MS);
    const listener = (value) => {
      if (!condition(value)) return;
      clearTimeout(timer);
      emitter.removeListener(event, listener);
      resolve(value);
    };
    emitter.on(event, listener);
  });
}

async function main() {
  const seen = {};
  const device = new Device({ id: 0x10 });
  const bus = await openBus(device);
  const eds = device.eds;
  eds.addSdoClientParameter(NODE, 0x600 + NODE, 0x580 + NODE);
  eds.addHeartbeatConsumer(NODE, 5000);
  eds.addEmcyConsumer(0x80 + NODE);
  eds.setSyncCobId(0x80);
  eds.setSyncGenerationEnable(true); // without a period: when it is told
  const controlword = eds.addEntry(0x6040, { parameterName: "Controlword", dataType: UNSIGNED16 });
  const torque = eds.addEntry(0x6071, { parameterName: "Target torque", dataType: INTEGER16 });
  const velocity = eds.addEntry(0x606c, { parameterName: "Velocity", dataType: INTEGER32 });
  const position = eds.addEntry(0x6064, { parameterName: "Position", dataType: INTEGER32 });
  eds.addTransmitPdo({ cobId: 0x200 + NODE, transmissionType: 255, dataObjects: [controlword, torque] });
  eds.addReceivePdo({ cobId: 0x280 + NODE, transmissionType: 1, dataObjects: [position, velocity] });

  const address = { deviceId: NODE, timeout: TIMEOUT_MS };
  const read = (index, subIndex, dataType, more = {}) =>
    device.sdo.upload({ ...address, index, subIndex, dataType, ...more });
  const write = (index, subIndex, dataType, data, more = {}) =>
    device.sdo.download({ ...address, index, subIndex, dataType, data, ...more });
  const abortOf = (transfer) => transfer.then(() => 0, (error) => error.code);

  device.start();
  device.nmt.startNode(); // ours: its PDOs and its SYNC

  // boot-up
  const booted = once(bus.frames, "frame", ({ id, data }) => id === 0x700 + NODE && data[0] === 0, "boot-up");
  device.nmt.resetNode(NODE);
  await booted;
  seen.boot_up = true;

  // SDO
  seen.device_type = await read(0x1000, 0, UNSIGNED32);
  seen.product_code = await read(0x1018, 2, UNSIGNED32);
  seen.device_name = await read(0x1008, 0, VISIBLE_STRING);
  seen.device_name_by_block = await read(0x1008, 0, VISIBLE_STRING, { blockTransfer: true });
  const text = "abcdefghijklmnopqrstuvwxyz".repeat(3).slice(0, 61);
  seen.texts = [];
  for (const length of [1, 4, 5, 7, 8, 14, 15, 61]) {
    await write(0x2000, 0, VISIBLE_STRING, text.slice(0, length));
    seen.texts.push((await read(0x2000, 0, VISIBLE_STRING)) === text.slice(0, length));
    await write(0x2000, 0, VISIBLE_STRING, text.slice(0, length).toUpperCase(), { blockTransfer: true });
    seen.texts.push((await read(0x2000, 0, VISIBLE_STRING)) === text.slice(0, length).toUpperCase());
  }
  seen.abort_no_object = await abortOf(read(0x5fff, 0, UNSIGNED8));
  seen.abort_read_only = await abortOf(write(0x1000, 0, UNSIGNED32, 1));

  // NMT, seen in the heartbeat
  await write(0x1017, 0, UNSIGNED16, 20);
  seen.nmt = [];
  const state = async (command, wanted) => {
    const shown = once(device.nmt, "heartbeat", (beat) => beat.deviceId === NODE && beat.state === wanted, command);
    device.nmt[command](NODE);
    seen.nmt.push((await shown).state);
  };
  await state("startNode", 5);
  await state("stopNode", 4);
  await state("startNode", 5);
  await state("enterPreOperational", 127);

  // PDO: a synchronous RPDO of its own mapping, and the drive's default TPDO2
  await write(0x1400, 1, UNSIGNED32, 0x80000200 + NODE);
  await write(0x1400, 2, UNSIGNED8, 1);
  await write(0x1600, 0, UNSIGNED8, 0);
  await write(0x1600, 1, UNSIGNED32, 0x60400010);
  await write(0x1600, 2, UNSIGNED32, 0x60710010);
  await write(0x1600, 0, UNSIGNED8, 2);
  await write(0x1400, 1, UNSIGNED32, 0x200 + NODE);
  await write(0x6060, 0, INTEGER8, 10);
  await state("startNode", 5);
  seen.statuswords = [];
  for (const word of [0x06, 0x07, 0x0f]) {
    controlword.value = word;
    device.pdo.write(0x200 + NODE);
    const before = await read(0x6041, 0, UNSIGNED16);
    // the frame itself: the module's "pdo" event is left out where no value changed, as on an axis at rest
    const answer = once(bus.frames, "frame", ({ id }) => id === 0x280 + NODE, "TPDO2");
    device.sync.write();
    await answer;
    seen.statuswords.push([before & 0x6f, (await read(0x6041, 0, UNSIGNED16)) & 0x6f]);
  }

  // a fault, as EMCY
  const emergency = once(device.emcy, "emergency", ({ em }) => em.code !== 0, "EMCY");
  await write(0x2100, 1, UNSIGNED8, 22); // overcurrent
  await write(0x2100, 6, UNSIGNED8, 1);
  const { em } = await emergency;
  seen.emcy = [em.code, em.register];
  seen.fault = (await read(0x6041, 0, UNSIGNED16)) & 0x4f;
  seen.error_code = await read(0x603f, 0, UNSIGNED16);
  await write(0x2100, 6, UNSIGNED8, 2);

  device.stop();
  bus.close();
  return seen;
}

main().then(
  (seen) => {
    console.log(JSON.stringify(seen));
    process.exit(0);
  },
  (error) => {
    console.error(error);
    process.exit(1);
  },
);
