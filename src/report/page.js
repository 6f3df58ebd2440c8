// The page's own buttons: the theme, and copying commands.
(() => {
  'use strict';
  const root = document.documentElement;
  const theme = document.getElementById('theme');
  const prefersDark = matchMedia('(prefers-color-scheme: dark)');
  const isDark = () =>
    root.classList.contains('dark') || (!root.classList.contains('light') && prefersDark.matches);
  const name = () => {
    theme.textContent = isDark() ? 'Light theme' : 'Dark theme';
  };
  theme.addEventListener('click', () => {
    const next = isDark() ? 'light' : 'dark';
    root.classList.remove('light', 'dark');
    root.classList.add(next);
    name();
  });
  prefersDark.addEventListener('change', name);
  name();
  theme.hidden = false;

  const said = document.getElementById('said');
  for (const button of document.querySelectorAll('button[data-copies]')) {
    const source = document.getElementById(button.dataset.copies);
    const report = (text) => {
      button.textContent = text;
      said.textContent = text;
      setTimeout(() => {
        button.textContent = 'Copy';
        said.textContent = '';
      }, 2000);
    };
    button.addEventListener('click', () => {
      const select = () => {
        getSelection().selectAllChildren(source);
        report('Selected');
      };
      if (navigator.clipboard) {
        navigator.clipboard.writeText(source.textContent).then(() => report('Copied'), select);
      } else {
        select();
      }
    });
    button.hidden = false;
  }
})();
