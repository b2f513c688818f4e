/** Bundle of a worker as text; `build.mjs` makes it. */
declare module "worker:*" {
  const code: string;
  export default code;
}
