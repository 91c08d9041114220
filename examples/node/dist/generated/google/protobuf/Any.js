// Original file: null
export {};
