// What is dropped: files, and folders, which become a ZIP so that a PMX keeps its textures.

import { zipSync, type Zippable } from "fflate";
import { open } from "./actions";
import { say } from "./state";

const CHARACTERS = [".pmx", ".pmd", ".gltf", ".obj", ".glb", ".vrm", ".fbx", ".stl", ".ply"];
const MOST_FILES = 2000;

async function walk(entry: FileSystemEntry, path: string, found: Map<string, File>): Promise<void> {
  if (found.size > MOST_FILES) {
    return;
  }
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
    found.set(path + file.name, file);
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (!some.length) {
      return;
    }
    for (const one of some) {
      await walk(one, `${path}${entry.name}/`, found);
    }
  }
}

/** One file as it is; several that belong to one character, or a folder, as one ZIP. */
export async function openAll(files: Map<string, File>): Promise<void> {
  const names = [...files.keys()];
  const single = files.values().next().value;
  const main = names.find((name) => CHARACTERS.some((suffix) => name.toLowerCase().endsWith(suffix)));
  if (files.size === 1 && single) {
    await open(single);
  } else if (main) {
    const packed: Zippable = {};
    for (const [name, file] of files) {
      packed[name] = [new Uint8Array(await file.arrayBuffer()), { level: 0 }];
    }
    const title = (main.split("/").pop() ?? "character").replace(/\.[^.]+$/, "");
    await open(new File([zipSync(packed) as Uint8Array<ArrayBuffer>], `${title}.zip`));
  } else {
    for (const file of files.values()) {
      await open(file);
    }
  }
}

export async function dropped(transfer: DataTransfer): Promise<void> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  const plain = [...transfer.files];
  const found = new Map<string, File>();
  if (entries.some((entry) => entry?.isDirectory)) {
    for (const entry of entries) {
      if (entry) {
        await walk(entry, "", found);
      }
    }
  } else {
    for (const file of plain) {
      found.set(file.name, file);
    }
  }
  if (!found.size) {
    say("nothing that can be opened was dropped", true);
    return;
  }
  await openAll(found);
}
