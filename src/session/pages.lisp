;;; anmech: the manual in HTML.
;;;
;;; make doc and make install put it into the folder doc beside the sources.
;;;
;;; Entry points: $anmech_page, $anmech_show_page.

(in-package :anmech)
(needs "session/prompt" "session/texts")

(defun manual-page ()
  "Its absolute name, or nil."
  (let ((file (probe-file (concatenate 'string *source-directory* "../doc/anmech.html"))))
    (and file (namestring file))))

(defun anchor-of (verb)
  "What makeinfo calls the place of its entry."
  (format nil "#index-~{~a~}" (loop for letter across (plain-name verb)
                                    collect (if (char= letter #\_) "_005f" letter))))

(maxima::defmfun maxima::$anmech_page (verb)
  "anmech_page(verb or false): the address of the manual, or of the verb's entry in it; false if there is none."
  (let ((file (manual-page)))
    (and file (format nil "file://~a~a" file (if verb (anchor-of verb) "")))))

(defun variable-of-shell (name)
  (let ((value #+gcl (si:getenv name) #+sbcl (sb-ext:posix-getenv name) #+ecl (ext:getenv name)
               #-(or gcl sbcl ecl) nil))
    (and value (string/= value ""))))

(defun screen-p ()
  (or (variable-of-shell "DISPLAY") (variable-of-shell "WAYLAND_DISPLAY")))

(maxima::defmfun maxima::$anmech_show_page (address open)
  "anmech_show_page(address, true, false or auto): a browser shows it, unless nobody could see that."
  (when (if (eq open 'maxima::$auto) (and (screen-p) (somebody-answers-p)) open)
    (maxima::mfuncall 'maxima::$system
                      (format nil "(xdg-open '~a' || open '~a') > /dev/null 2>&1 &" address address)))
  'maxima::$done)
